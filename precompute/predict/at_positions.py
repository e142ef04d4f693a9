"""Steady drives for fingers at any positions, with the spread of what the fingers feel and the rise time.

The drive is the one that the live engine solves (engine.steady.steady_solver), from the same modes. Its figures
are computed apart from it, on the plant solved at the drive's own frequency with every sampled finger where it lies.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from base.arrays import Array
from engine.device import Device
from engine.steady import SteadyDrive
from engine.steady.cases import FingerCases, axes_of, cases_at, sample_deviations
from engine.steady.modes import Modes
from engine.steady.steady_solver import SteadySolver
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.model.plant import Plant
from precompute.predict.performance import compute_figures
from precompute.predict.rise_time import compute_rise_model, compute_rise_time
from precompute.sampling.fingers import SAMPLES, SampledFingers
from precompute.sampling.steady_modes import steady_basis, steady_modes
from precompute.sampling.surfaces import sample_surfaces

PERCENTS = (5, 50, 95)  # the median, and what nine of ten cases lie between


@dataclass(frozen=True)
class Percentiles:
    """5th, 50th and 95th percentile over the sampled cases, dB."""

    low_db: float
    middle_db: float
    high_db: float


@dataclass(frozen=True)
class Spread:
    """How levels are distributed over the sampled cases.

    felt: of the weakest felt finger; quiet: of the strongest quiet one; contrast: of both in one case. None where
    nothing is quiet.
    """

    felt: Percentiles
    quiet: Percentiles | None
    contrast: Percentiles | None


@dataclass(frozen=True)
class PlacementFigures:
    """What fingers at positions_m (finger,) feel of a drive that was solved for them.

    level_db (finger,) and contrast_db: standard fingers; sampled_level_db (case, finger): sampled fingers, each on a
    bar of its own where a calibration left some. contrasts are None where nothing is quiet.
    """

    positions_m: tuple[complex, ...]
    drive: SteadyDrive
    level_db: Array
    sampled_level_db: Array
    contrast_db: float | None
    expected_contrast_db: float | None
    spread: Spread
    t90_s: float
    """Time from rest after which the envelope under every felt standard finger stays within 10 % of its final value.

    precompute.predict.rise_time.LONGEST_RISE_S: longer than that.
    """

    def finger_percentiles(self, finger: int) -> Percentiles:
        """Level under one finger (index) over the sampled cases."""
        return _percentiles(self.sampled_level_db[:, finger])


class SteadyDesigner:
    """Solves drives for placements on one device, and computes their figures.

    `modes` are those of its table; without them they are computed. `samples`: of the
    fingers, even, over which the figures are; the solver optimises over fewer of its own.
    """

    def __init__(
        self, device: Device, plant: Plant | None = None, modes: Modes | None = None, samples: int = SAMPLES
    ) -> None:
        self.plant, self._samples = plant or assemble(device), samples
        self.basis = compute_basis(self.plant)
        self.modes = modes or steady_modes(steady_basis(self.plant))
        self.solver = SteadySolver(device, self.modes)

    def solve(self, positions_m: Sequence[complex], felt: Sequence[bool], level_db: float) -> PlacementFigures:
        """The drive for fingers at these positions, `felt` or else quiet, at a level in dB, and its figures.

        Raises engine.steady.steady_solver.SteadyError as SteadySolver.solve does.
        """
        drive = self.solver.solve(positions_m, felt, level_db)
        device, positions = self.plant.device, np.array(positions_m)
        corner_m = device.surface.corner_m
        deviations = sample_deviations(len(positions), self._samples, axes_of(corner_m))
        sampled = _sampled_fingers(cases_at(positions, deviations, device.finger, corner_m))
        touched = range(len(positions))
        hz, amplitude = np.full(len(drive.amplitudes), drive.frequency_hz), drive.complex_amplitudes
        power = compute_figures(self.plant, sampled, touched, hz, amplitude).power
        bars = None if self.plant.is_measured else sample_surfaces(device, sampled)
        cases = power[1:] if bars is None else bars.powers(touched, hz, amplitude)
        level_db_of, sampled_db = (10 * np.log10(np.maximum(each, 1e-30)) for each in (power[0], cases))
        is_felt = np.array(felt, dtype=np.bool_)
        weakest = sampled_db[:, is_felt].min(axis=1)
        strongest = sampled_db[:, ~is_felt].max(axis=1, initial=-np.inf)
        is_quiet, mean = bool((~is_felt).any()), power[1:].mean(axis=0)
        model = compute_rise_model(self.basis, [sampled.fingers(0, touched)], positions[None])
        return PlacementFigures(
            positions_m=tuple(positions.tolist()),
            drive=drive,
            level_db=level_db_of,
            sampled_level_db=sampled_db,
            contrast_db=float(level_db_of[is_felt].min() - level_db_of[~is_felt].max()) if is_quiet else None,
            expected_contrast_db=float(10 * np.log10(mean[is_felt].min() / mean[~is_felt].max())) if is_quiet else None,
            spread=Spread(
                felt=_percentiles(weakest),
                quiet=_percentiles(strongest) if is_quiet else None,
                contrast=_percentiles(weakest - strongest) if is_quiet else None,
            ),
            t90_s=float(compute_rise_time(model, hz, amplitude)[0, is_felt].max()),
        )


def _sampled_fingers(cases: FingerCases) -> SampledFingers:
    """The cases as sampled fingers: each finger stands for a zone, which has a place for each case."""
    count, fingers = cases.position_m.shape
    return SampledFingers(
        position_m=np.ascontiguousarray(cases.position_m.T),
        place=np.repeat(np.arange(count)[:, None], fingers, axis=1),
        mass_kg=cases.impedance[:, :, 2],
        damping_n_s_per_m=cases.impedance[:, :, 1],
        stiffness_n_per_m=cases.impedance[:, :, 0],
    )


def _percentiles(level_db: Array) -> Percentiles:
    return Percentiles(*np.percentile(level_db, PERCENTS).tolist())
