"""Contrast of one felt and one quiet finger in the middles of every two zones: how well a bar tells fingers apart."""

import itertools
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from base.arrays import Array
from engine.device import Device
from engine.steady.steady_solver import SteadySolver
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.predict.at_positions import SteadyDesigner
from precompute.sampling.steady_modes import steady_modes

Pair = tuple[int, int]

_MODES = 24  # of the screening: as many as the page's moving bar has; more change its levels by < 0.05 dB


@dataclass(frozen=True)
class TwoFingers:
    """Expected contrast and level of the felt finger, each (felt zone, quiet zone) in dB; NaN on the diagonal.

    Where full scale does not reach `wanted_db`, the level is the greatest there is and the contrast that of this drive.
    """

    wanted_db: float
    contrast_db: Array
    level_db: Array

    @cached_property
    def is_reached(self) -> bool:
        """Whether every felt finger gets the wanted level."""
        return bool(np.nanmin(self.level_db) >= self.wanted_db - 1e-3)

    @cached_property
    def worst_db(self) -> float:
        """Contrast of the worst pair."""
        return float(np.nanmin(self.contrast_db))

    @cached_property
    def rank(self) -> tuple[bool, float]:
        """Greater is better: the level first, then the worst contrast; where the level is missed, by how much."""
        return self.is_reached, self.worst_db if self.is_reached else float(np.nanmin(self.level_db))


def finger_pairs(device: Device) -> list[Pair]:
    """Every felt and quiet zone (indices); those with the same fingers one after another."""
    return [pair for two in itertools.combinations(range(len(device.zones)), 2) for pair in (two, two[::-1])]


def solve_two_fingers(device: Device, wanted_db: float) -> TwoFingers:
    """Contrasts of the drives that a run solves for these fingers at `wanted_db`."""
    return _contrasts(device, SteadyDesigner(device).solver, wanted_db)


def screen_two_fingers(device: Device, wanted_db: float, step_hz: float) -> TwoFingers:
    """The same estimated quickly, from few modes and frequencies `step_hz` apart."""
    coarse = replace(device, sweep=replace(device.sweep, step_hz=step_hz))
    modes = steady_modes(compute_basis(assemble(coarse), _MODES))
    return _contrasts(coarse, SteadySolver(coarse, modes), wanted_db)


def _contrasts(device: Device, solver: SteadySolver, wanted_db: float) -> TwoFingers:
    middle_m = [(zone.start_m + zone.stop_m) / 2 for zone in device.zones]
    contrast_db, level_db = (np.full((len(middle_m),) * 2, np.nan) for _ in range(2))
    for felt, quiet in finger_pairs(device):
        drive = solver.solve([middle_m[felt], middle_m[quiet]], [True, False], wanted_db)
        contrast_db[felt, quiet], level_db[felt, quiet] = drive.expected_contrast_db, drive.weakest_felt_db
    return TwoFingers(wanted_db, contrast_db, level_db)
