"""A click of a table: the weights of its short waveform for one placement of the fingers, and what it promises."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from base.arrays import Array
from engine.table.levels import LEVEL_TOLERANCE_DB, shifted
from engine.touch import Placement
from firmware_link.protocol.basis import SAMPLE_FULL_SCALE, Basis, Samples, weighted_sum


@dataclass(frozen=True)
class LevelSpread:
    """Peak level above threshold, dB: of the nominal plant, and 5th, 50th and 95th percentile of sampled plants.

    worst_db: of all these plants, the weakest where felt, and the strongest where quiet.
    """

    nominal_db: float
    low_db: float
    middle_db: float
    high_db: float
    worst_db: float


@dataclass(frozen=True)
class ClickFinger:
    """Peaks under one finger, in the nominal plant."""

    acceleration_at_finger_m_per_s2: float
    level_db: float  # weighted by the detection threshold


@dataclass(frozen=True, eq=False)
class ClickFigures:
    """Levels and times of a waveform under the fingers of a placement.

    The spreads are over sampled plants; all other figures are of the nominal plant.
    exceeds_s: for each level, rising, the time at which every felt finger has passed its threshold when the click is
    played at that level; None: one of them never does.
    """

    felt: LevelSpread  # the weakest felt finger
    quiet: LevelSpread | None  # the strongest quiet finger; None: nothing is quiet
    fingers: tuple[ClickFinger, ...]  # for each finger of the placement, in order
    exceeds_s: Mapping[float, float | None]
    peak_s: float  # when the last felt finger has its peak
    residual_from_s: float
    residual_db: float  # the strongest felt finger from residual_from_s on


@dataclass(frozen=True, eq=False)
class ClickEntry(ClickFigures):
    """Weights (function,) of a set of a basis, played at `amplitude` (fraction of full scale), and their figures.

    A weight is in steps of 2^-fraction_bits. placement: the positions of the places that the click is made for; each
    finger lies within `tolerance_m` of its place in the sampled plants.
    """

    placement: Placement
    tolerance_m: float
    basis: Basis
    basis_set: int
    weights: NDArray[np.int16]
    fraction_bits: int
    amplitude: float = 1.0
    wanted_level_db: float = math.inf  # the level that is asked for; infinite: as strong as solved

    @property
    def achieved(self) -> bool:
        """Whether the wanted level is reached: full scale and the quiet level may allow less."""
        return math.isinf(self.wanted_level_db) or self.level_db >= self.wanted_level_db - LEVEL_TOLERANCE_DB

    @property
    def level_db(self) -> float:
        """The level that 95 % of the sampled plants reach under every felt finger."""
        return self.felt.low_db

    @cached_property
    def samples(self) -> Samples:
        """Base displacement (sample, actuator) at full amplitude, linear between samples, of SAMPLE_FULL_SCALE."""
        number = self.basis.number_of_actuators
        return weighted_sum(self.basis.sets[self.basis_set], self.weights, self.fraction_bits, number).astype(np.int16)

    @property
    def waveform(self) -> Array:
        """Base displacement (sample, actuator) as played, a fraction of full scale, linear between samples."""
        return self.amplitude / SAMPLE_FULL_SCALE * self.samples.astype(np.float64)

    @property
    def sample_rate_hz(self) -> int:
        """Rate of the samples."""
        return self.basis.sample_rate_hz

    @property
    def length_s(self) -> float:
        """Length of the waveform."""
        return (self.basis.sets[self.basis_set].samples - 1) / self.sample_rate_hz

    def exceeds_at_s(self) -> float | None:
        """When every felt finger has passed its threshold, at the wanted level or the next lower tabulated one."""
        levels_db = [level_db for level_db in self.exceeds_s if level_db <= self.wanted_level_db]
        return self.exceeds_s[max(levels_db)] if levels_db else None


def played_at(click: ClickEntry, level_db: float) -> ClickEntry:
    """The click played softer, so that just 95 % of the plants reach `level_db`; never louder than tabulated.

    All levels fall together, so quiet fingers stay below what was promised. ESTIMATE: the actuators are linear.
    """
    change_db = min(0.0, level_db - click.level_db)
    scale = 10 ** (change_db / 20)
    return replace(
        click,
        amplitude=click.amplitude * scale,
        wanted_level_db=level_db,
        felt=shifted(click.felt, change_db),
        quiet=click.quiet and shifted(click.quiet, change_db),
        fingers=tuple(
            ClickFinger(each.acceleration_at_finger_m_per_s2 * scale, each.level_db + change_db)
            for each in click.fingers
        ),
        residual_db=click.residual_db + change_db,
    )
