"""Contrast of one felt and one quiet finger for every two zones: how well a bar tells fingers apart."""

import itertools
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from engine.device import Device
from engine.touch import ZoneState
from precompute.entries.dual_bound import definite, solve_eigen
from precompute.entries.objective import Problem, contrast
from precompute.entries.prediction import States
from precompute.entries.scan import scan
from precompute.entries.search import pack_directions, pack_forms, search_directions
from precompute.entries.solver import EntrySolver
from precompute.model.assembly import assemble
from precompute.predict.forms import compute_forms
from precompute.sampling.fingers import SampledFingers
from precompute.sampling.receptance import solve_receptance

Array = NDArray[np.float64]
Pair = tuple[int, int]


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
        """Contrast of the worst state."""
        return float(np.nanmin(self.contrast_db))

    @cached_property
    def rank(self) -> tuple[bool, float]:
        """Greater is better: the level first, then the worst contrast; where the level is missed, by how much."""
        return self.is_reached, self.worst_db if self.is_reached else float(np.nanmin(self.level_db))


def finger_pairs(device: Device) -> list[Pair]:
    """Every felt and quiet zone (indices); those with the same fingers one after another."""
    return [pair for two in itertools.combinations(range(len(device.zones)), 2) for pair in (two, two[::-1])]


def solve_two_fingers(device: Device, wanted_db: float) -> TwoFingers:
    """Contrasts by the entries that a table of the device holds at `wanted_db`."""
    solver = EntrySolver(assemble(_at_level(device, wanted_db)))
    contrast_db, level_db = _empty(device), _empty(device)
    for felt, quiet in finger_pairs(device):
        entry = solver.solve(_states(device, felt, quiet))[0]
        assert entry.expected_contrast_db is not None
        contrast_db[felt, quiet], level_db[felt, quiet] = entry.expected_contrast_db, min(entry.level_db, wanted_db)
    return TwoFingers(wanted_db, contrast_db, level_db)


def screen_two_fingers(device: Device, sampled: SampledFingers, wanted_db: float, step_hz: float) -> TwoFingers:
    """Contrasts estimated quickly, from a fixed set of drives of one tone every `step_hz`.

    Its contrasts are lower bounds of what the search finds. `sampled` fingers do not depend on the actuators.
    """
    sweep = device.sweep
    count = round((sweep.stop_hz - sweep.start_hz) / step_hz) + 1
    frequency_hz = np.linspace(sweep.start_hz, sweep.stop_hz, count)
    receptance = solve_receptance(assemble(device), sampled, frequency_hz)
    directions = pack_directions(search_directions(len(device.actuators)))
    wanted = 10 ** (wanted_db / 10) / device.limits.amplitude**2
    contrast_db, level_db = _empty(device), _empty(device)
    for two in itertools.combinations(range(len(device.zones)), 2):
        forms = compute_forms(receptance, two)
        for felt, quiet in (two, two[::-1]):
            ratio, power = _scan_best(contrast(forms, _states(device, felt, quiet)), directions, wanted)
            contrast_db[felt, quiet] = 10 * np.log10(ratio)
            level_db[felt, quiet] = min(wanted_db, wanted_db + 10 * np.log10(power / wanted))
    return TwoFingers(wanted_db, contrast_db, level_db)


def _scan_best(problem: Problem, directions: NDArray[np.float32], wanted: float) -> tuple[float, float]:
    """The greatest ratio above the wanted power, or that of the loudest drive if it falls short; the greatest power."""
    muted = problem.muted()
    ratio, power = _loudest(muted)
    if power < wanted:
        return ratio, power
    score = np.empty((len(problem.frequency_hz), 2), dtype=np.float32)
    arg = np.empty(score.shape, dtype=np.int64)
    numerator, denominator, level = map(pack_forms, muted.stacks)
    scan(numerator, denominator, level, directions, np.array([wanted], dtype=np.float32), score, arg)
    return max(ratio, float(score[:, 0].max()), _purest(muted, wanted)), power


def _loudest(problem: Problem) -> tuple[float, float]:
    """Ratio and power of the loudest drive of one tone.

    One finger's power is |sum_l h_l a_l|^2: greatest with every |a_l| at 1, all in phase under it.
    """
    (N,), (D,), (P,) = problem.stacks
    at = int(np.sqrt(np.einsum("faa->fa", P).real).sum(axis=1).argmax())
    column = P[at][:, np.diag(P[at]).real.argmax()]
    drive = np.where(column == 0, 0, np.exp(1j * np.angle(column)))
    ratio, power = (drive.conj() @ N[at] @ drive / (drive.conj() @ D[at] @ drive), drive.conj() @ P[at] @ drive)
    return float(ratio.real), float(power.real)


def _purest(problem: Problem, wanted: float) -> float:
    """The greatest ratio of one tone, where the drive that has it is loud enough; 0 where no such drive is."""
    (N,), (D,), (P,) = problem.stacks
    value, drive = solve_eigen(N, definite(D))
    drive /= abs(drive).max(axis=1, keepdims=True)
    power = np.einsum("fa,fab,fb->f", drive.conj(), P, drive).real
    return float(np.where(power >= wanted, value, 0.0).max())


def _states(device: Device, felt: int, quiet: int) -> States:
    states = [ZoneState.FREE] * len(device.zones)
    states[felt], states[quiet] = ZoneState.FELT, ZoneState.QUIET
    return tuple(states)


def _at_level(device: Device, wanted_db: float) -> Device:
    return replace(device, levels_db=(wanted_db,))


def _empty(device: Device) -> Array:
    return np.full((len(device.zones),) * 2, np.nan)
