"""Detection threshold as a causal filter: acceleration in, acceleration over threshold out."""

import numpy as np

from base.arrays import Array
from engine.device import Threshold

LENGTH_S = 0.1
"""Length of the filter; what is cut off changes its magnitude by less than 0.03 dB from 30 Hz to 1 kHz.

For the curve `android`, which has corners close to each other, by less than 0.2 dB.
"""
_LOWEST_HZ = 10.0  # below, where nothing is known and the bar has no mode, the threshold is held
_FINE = 1 << 16


def threshold_filter(threshold: Threshold, sample_rate_hz: float) -> Array:
    """Taps (time,) whose magnitude is one over the detection threshold at every frequency, by the minimum phase.

    Causal and with the least delay: nothing is felt before the bar moves, so that times of being felt mean something;
    a zero-phase filter would ring ahead of the click. Of a steady tone it keeps the sensation level. The phase follows
    from the folded cepstrum (Oppenheim and Schafer, Discrete-Time Signal Processing, homomorphic systems).
    """
    frequency_hz = np.maximum(np.fft.rfftfreq(_FINE, 1 / sample_rate_hz), _LOWEST_HZ)
    cepstrum = np.fft.irfft(-np.log(threshold.peak_m_per_s2(frequency_hz)))
    cepstrum[1 : _FINE // 2] *= 2
    cepstrum[_FINE // 2 + 1 :] = 0
    return np.fft.irfft(np.exp(np.fft.rfft(cepstrum)))[: round(LENGTH_S * sample_rate_hz)]
