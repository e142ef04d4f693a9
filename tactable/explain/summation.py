"""Temporal summation: what a short vibration is to a skin that adds up energy, as a correction that may be chosen.

Thresholds were measured with vibrations of about a second, and the Pacinian channel feels shorter ones less: thresholds
of 250 and 500 Hz over duration follow Zwislocki's theory (Gescheider and others, J. Acoust. Soc. Am. 95, 1006, 1994),
those below some 40 Hz do not fall. Its neural sum decays within 200 ms (Zwislocki, J. Acoust. Soc. Am. 32, 1046, 1960),
so that a burst of length t counts 10 log(1 - exp(-t / 200 ms)) dB: -8.6 dB for 30 ms, -3 dB for each halving. The time
constant is that of hearing, and that all of a click is felt by this one channel is an ESTIMATE.
"""

from enum import Enum

import numpy as np
from scipy.signal import lfilter

from base.arrays import Array
from precompute.clicks.evaluation import decibels

_TIME_CONSTANT_S = 0.2


class Summation(Enum):
    """How a level follows from the course of a click."""

    NONE = "none"
    ZWISLOCKI = "zwislocki-1960"


SAID = {
    Summation.NONE: "levels compare a peak with the threshold of lasting vibration: temporal summation is not "
    "corrected, so a click may need more than 0 dB (--summation zwislocki-1960)",
    Summation.ZWISLOCKI: "levels of the fingers are of the energy that is added up over 200 ms, after Zwislocki 1960, "
    "an ESTIMATE for clicks; what is promised above is of peaks",
}
"""What a level stands on, by the correction."""


def summed_db(weighted: Array, rate_hz: float) -> Array:
    """Greatest level in dB of courses (..., time) over the threshold, each the sum of what is not yet forgotten.

    A lasting sine keeps the level of its peak.
    """
    kept = np.exp(-1 / (_TIME_CONSTANT_S * rate_hz))
    power: Array = lfilter([2 * (1 - kept)], [1, -kept], weighted**2)
    return decibels(np.sqrt(power.max(axis=-1)))
