"""Steady drives for fingers at any positions, with the spread of what the fingers feel and the rise time.

The drive is the one that the live engine solves (engine.steady.steady_solver), from the same modes. Its figures
are computed apart from it, on the plant solved at the drive's own frequency with every sampled finger where it lies.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from base.arrays import Array, Complex
from engine.device import Device, Finger
from engine.steady import SteadyDrive
from engine.steady.cases import SEED, FingerCases, axes_of, cases_at, sample_deviations
from engine.steady.modes import Modes
from engine.steady.steady_solver import SteadySolver
from precompute.model.assembly import assemble, free_surface
from precompute.model.modal import compute_basis
from precompute.model.plant import FreeSurface, Plant
from precompute.model.response import by_tone, solve_response
from precompute.predict.rise_time import compute_rise_model, compute_rise_time
from precompute.sampling.plants import Fingers, Scenarios, sample_scenarios
from precompute.sampling.steady_modes import steady_basis, steady_modes

SAMPLES = 32  # sampled cases, each with a finger of its own at every position
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

    level_db (finger,) and contrast_db: standard fingers; sampled_level_db (case, finger): sampled fingers, each on
    a plant of its own where a calibration left some, or the spread has other surfaces and channels. contrasts are
    None where nothing is quiet.
    """

    positions_m: tuple[complex, ...]
    drive: SteadyDrive
    level_db: Array
    sampled_level_db: Array
    contrast_db: float | None
    expected_contrast_db: float | None
    spread: Spread
    loads: tuple[list[tuple[complex, Finger]], ...]
    """Point and finger of every finger, standard ones first, then those of each sampled case."""
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
        self._bars, self._scenarios = ([], None) if self.plant.is_measured else sample_bars(device, samples)

    def solve(self, positions_m: Sequence[complex], felt: Sequence[bool], level_db: float) -> PlacementFigures:
        """The drive for fingers at these positions, `felt` or else quiet, at a level in dB, and its figures.

        Raises engine.steady.steady_solver.SteadyError as SteadySolver.solve does.
        """
        drive = self.solver.solve(positions_m, felt, level_db)
        device, positions = self.plant.device, np.array(positions_m)
        deviations = sample_deviations(len(positions), self._samples, axes_of(device.surface.corner_m))
        cases = cases_at(positions, deviations, device)
        hz, amplitude = np.full(len(drive.amplitudes), drive.frequency_hz), drive.complex_amplitudes
        power = compute_powers(self.plant, cases, hz, amplitude)
        own = [
            compute_powers(bar, FingerCases(cases.position_m[[k]], cases.impedance[[k]]), hz, amplitude * channels)
            for k, (bar, channels) in enumerate(zip(self._bars, self._channels(drive.frequency_hz), strict=True), 1)
        ]
        sampled = np.concatenate(own or [power[1:]])
        level_db_of, sampled_db = (10 * np.log10(np.maximum(each, 1e-30)) for each in (power[0], sampled))
        is_felt = np.array(felt, dtype=np.bool_)
        weakest = sampled_db[:, is_felt].min(axis=1)
        strongest = sampled_db[:, ~is_felt].max(axis=1, initial=-np.inf)
        is_quiet, mean = bool((~is_felt).any()), (10 ** (sampled_db / 10)).mean(axis=0)
        fingers = Fingers(cases.position_m, *np.moveaxis(cases.impedance, 2, 0))
        loads = tuple(fingers.of(case) for case in range(len(power)))
        model = compute_rise_model(self.basis, loads[0], positions)
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
            loads=loads,
            t90_s=float(compute_rise_time(model, hz, amplitude)[is_felt].max()),
        )

    def _channels(self, hz: float) -> Complex:
        """What the channels of the sampled plants make of a command at a frequency (plant, actuator)."""
        scenarios = self._scenarios
        channels = None if scenarios is None else scenarios.channels(np.array([2j * np.pi * hz]))
        known = np.ones((len(self._bars), len(self.plant.device.actuators)))
        return np.asarray(known if channels is None else channels[1:, :, 0], dtype=np.complex128)


def compute_powers(plant: Plant, cases: FingerCases, frequency_hz: Array, amplitude: Complex) -> Array:
    """Power over threshold (case, finger) under a drive, frequency_hz, amplitude (actuator,); those of tones add.

    Fingers are attached to the responses of the untouched surface, which may have been measured.
    """
    tones_hz, weight = by_tone(frequency_hz, amplitude)
    omega, actuators, (count, fingers) = 2 * np.pi * tones_hz, weight.shape[1], cases.position_m.shape
    points_m = cases.position_m.ravel()
    moved = plant.sampler(points_m).sample(solve_response(plant, tones_hz, points_m).displacement_m)
    free = np.einsum("ta,tap->tp", weight, moved[:, :actuators]).reshape(-1, count, fingers, 1)
    receptance = np.einsum("tcpcq->tcpq", moved[:, actuators:].reshape(-1, count, fingers, count, fingers))
    stiffness, damping, mass = np.moveaxis(cases.impedance, 2, 0)
    w = omega[:, None, None]
    impedance = stiffness - w**2 * mass + 1j * w * damping
    under = np.linalg.solve(np.eye(fingers) + receptance * impedance[:, :, None], free)[..., 0]
    per_threshold = omega**2 / plant.device.threshold.peak_m_per_s2(tones_hz)
    return (abs(under * per_threshold[:, None, None]) ** 2).sum(axis=0)


def sample_bars(device: Device, count: int) -> tuple[list[Plant], Scenarios | None]:
    """`count` plants within what is not known of surface and channels, and their scenarios, the nominal one first.

    The list is empty, and the scenarios are None, for a device without a calibration whose spread varies fingers alone,
    such as "bench". What was fitted varies as the calibration has left it, the rest within the device's spread.
    """
    if device.uncertainty is None and not device.spread.is_of_bars:
        return [], None
    scenarios, free = sample_scenarios(device, count, SEED), dict[complex, FreeSurface]()
    bars = list[Plant]()
    for index in range(1, count + 1):
        other = scenarios.device_of(index)
        corner_m = other.surface.corner_m
        if corner_m not in free:
            free[corner_m] = free_surface(other)
        bars.append(free[corner_m].plant(other))
    return bars, scenarios


def _percentiles(level_db: Array) -> Percentiles:
    return Percentiles(*np.percentile(level_db, PERCENTS).tolist())
