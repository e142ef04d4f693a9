"""Source of clicks for fingers at positions: the table's row of their places, or a click that is solved now.

Both are evaluated alike: on plants that no click was made with, and in the nominal plant with standard fingers.
"""

from dataclasses import replace
from enum import Enum
from functools import cached_property
from math import inf

import numpy as np
from scipy.signal import lfilter

from base.arrays import Array, Complex
from engine.table import ClickEntry, Table, TableError
from engine.table.clicks import ClickFinger
from engine.touch import Placement
from precompute.clicks import ClickSolver
from precompute.clicks.click_basis import EVALUATION_RATE_HZ
from precompute.clicks.click_options import read_click_options
from precompute.clicks.evaluation import NominalFingers, decibels

_TIME_CONSTANT_S = 0.2


class Summation(Enum):
    """How a level follows from the course of a click: temporal summation, what a short vibration is to a skin.

    Thresholds were measured with vibrations of about a second, and the Pacinian channel feels shorter ones less:
    thresholds of 250 and 500 Hz over duration follow Zwislocki's theory (Gescheider and others, J. Acoust. Soc. Am. 95,
    1006, 1994), those below some 40 Hz do not fall. Its neural sum decays within 200 ms (Zwislocki, J. Acoust. Soc. Am.
    32, 1046, 1960), so that a burst of length t counts 10 log(1 - exp(-t / 200 ms)) dB: -8.6 dB for 30 ms, -3 dB for
    each halving. The time constant is that of hearing, and that all of a click is felt by this one channel is an
    ESTIMATE.
    """

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


class ClickSource:
    """Clicks of a table's device, for fingers within `tolerance_m` of the positions; None: as the device's spread says.

    summation: how levels of clicks under fingers follow from their courses.
    """

    def __init__(self, table: Table, tolerance_m: float | None = None, summation: Summation = Summation.NONE) -> None:
        self.table, self.summation = table, summation
        within_m = table.device.spread.reach_m if tolerance_m is None else tolerance_m
        self.options = replace(read_click_options(table), tolerance_m=within_m)  # of the clicks that are solved now

    @cached_property
    def solver(self) -> ClickSolver:
        """Solver of clicks for positions; its plants take a second."""
        return ClickSolver(self.table.device, self.options, self.table.clicks.basis)

    @cached_property
    def _nominal(self) -> NominalFingers:
        modes = self.table.attributes.get("modes")  # counting them takes compiled kernels
        return NominalFingers(self.table.device, None if modes is None else int(modes.item()))

    def holds(self, placement: Placement) -> bool:
        """Whether the table has the click of the nearest places."""
        return self.table.click_at(placement, inf) is not None

    def click_of(self, placement: Placement) -> ClickEntry:
        """The table's click of the nearest places at full strength, else one that is solved for the positions.

        Raises TableError where no finger is felt.
        """
        return self.table.click_at(placement, inf) or self.solve(placement)

    def solve(self, placement: Placement) -> ClickEntry:
        """The click made for these positions, at full strength. Raises TableError where no finger is felt."""
        if not placement.felt:
            raise TableError(f"{self.table.path}: a click is for felt fingers: name at least one, such as --felt I")
        return self.solver.solve(placement)

    def fingers_of(self, click: ClickEntry, placement: Placement) -> tuple[ClickFinger, ...]:
        """Levels of a click under standard fingers at these positions, in the nominal plant."""
        return self._nominal.under(click, placement.position_m)

    def levels_of_click(self, click: ClickEntry, placement: Placement) -> Array:
        """Level of a click, dB above threshold, (plant, finger): the nominal plant, then those of the judge."""
        judged = self.solver.plants_of(placement.position_m).judged
        if self.summation is Summation.ZWISLOCKI:
            return summed_db(judged.play(click.waveform.T).astype(np.float64), EVALUATION_RATE_HZ)
        return decibels(judged.peaks(click.waveform.T, range(len(placement.position_m))))

    def levels_of_drive(self, placement: Placement, hz: Array, amplitude: Complex) -> Array:
        """The same of a steady drive; hz, amplitude (actuator,). Tones of different frequencies add in power."""
        tones_hz, tone = np.unique(hz, return_inverse=True)
        drive = np.where(tone[:, None] == np.arange(len(tones_hz)), amplitude[:, None], 0)
        reached = np.einsum("pfak,ak->pfk", self.solver.tones_of_plants(placement.position_m, tones_hz), drive)
        return decibels(np.linalg.norm(reached, axis=2))
