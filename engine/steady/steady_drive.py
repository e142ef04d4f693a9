"""Steady drives: what the fingers feel of one that the solver found, and of one that a device was sent, in NumPy.

A drive that was sent has a frequency for each actuator. The solver states levels over the few cases that it optimises
for, those of a given drive are over more, of the same spread, under fingers at any positions. Responses are
interpolated over frequency and place as the solver interpolates them (engine.steady.drive_search). All fingers of a
case are attached at once, by one small system of equations. `engine.steady.loading` does the same by compiled kernels.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from base.arrays import Array, Complex, Points
from engine.device import Device
from engine.steady.cases import Deviations, FingerCases, PlantErrors, axes_of, cases_at, sample_deviations
from engine.steady.modes import Modes
from engine.touch.placement import MOST_FINGERS

LEVEL_TOLERANCE_DB = 1e-3  # the same as in engine.table.levels; this package needs no table
_LEAST_POWER = 1e-30  # -300 dB: silence has a logarithm
CASES = 32  # as many as `tactable explain` takes for fingers at positions
_NEIGHBOURS = 4
_deviations = lru_cache(maxsize=MOST_FINGERS)(sample_deviations)


@dataclass(frozen=True)
class SteadyDrive:
    """One frequency for all actuators, amplitudes (fraction of full scale) and phases, and what the fingers feel.

    level_db (finger,): under the standard fingers; sampled_level_db (case, finger): under the sampled ones.
    """

    frequency_hz: float
    amplitudes: tuple[float, ...]
    phases_rad: tuple[float, ...]
    felt: tuple[bool, ...]
    wanted_level_db: float
    level_db: Array
    sampled_level_db: Array
    objective: str  # "contrast", "localized factor", or "level" where the loudest drive was asked for or is the nearest
    value: float  # what was maximised: expected contrast or level in dB, or a share
    achieved: bool  # whether the weakest felt standard finger is at the wanted level; an infinite one is always reached

    @classmethod
    def at_level(
        cls,
        wanted_db: float,
        limit: float,
        frequency_hz: float,
        amplitude: Complex,
        power: Array,
        felt: Sequence[bool],
        objective: str,
        value: float,
    ) -> "SteadyDrive":
        """A drive that was found, played softer where it is louder than the wanted level.

        amplitude (actuator,): complex, the strongest at 1, which is played at `limit` at most. power (case, finger): of
        that amplitude, over threshold, the standard case first. value: a share, or a ratio of powers.
        """
        full_db = 10 * np.log10(power[0, list(felt)].min() * limit**2)
        scale = limit * 10 ** (min(0.0, wanted_db - full_db) / 20)
        sensed_db = 10 * np.log10(np.maximum(power, _LEAST_POWER)) + 20 * np.log10(scale)
        if objective != "localized factor":
            value = float(10 * np.log10(value)) + (20 * float(np.log10(limit)) if objective == "level" else 0.0)
        return cls(
            frequency_hz=frequency_hz,
            amplitudes=tuple(np.minimum(abs(amplitude) * scale, limit).tolist()),
            phases_rad=tuple(np.angle(amplitude).tolist()),
            felt=tuple(felt),
            wanted_level_db=wanted_db,
            level_db=sensed_db[0],
            sampled_level_db=sensed_db[1:],
            objective=objective,
            value=value,
            achieved=bool(np.isinf(wanted_db) or full_db >= wanted_db - LEVEL_TOLERANCE_DB),
        )

    @property
    def frequencies_hz(self) -> tuple[float, ...]:
        """Frequency of each actuator: the same one."""
        return (self.frequency_hz,) * len(self.amplitudes)

    @property
    def complex_amplitudes(self) -> Complex:
        """Complex amplitudes (actuator,), fractions of full scale."""
        return np.array(self.amplitudes) * np.exp(1j * np.array(self.phases_rad))

    @property
    def weakest_felt_db(self) -> float:
        """Level of the weakest felt standard finger."""
        return float(self.level_db[list(self.felt)].min())

    @property
    def expected_contrast_db(self) -> float | None:
        """Weakest felt over strongest quiet power, averaged over the sampled cases; None: nothing is quiet.

        The cases are the few that the solver maximises over; `tactable explain` evaluates a drive over others.
        """
        if all(self.felt):
            return None
        expected, felt = (10 ** (self.sampled_level_db / 10)).mean(axis=0), np.array(self.felt)
        return float(10 * np.log10(expected[felt].min() / expected[~felt].max()))


def compute_levels(
    device: Device, modes: Modes, positions_m: Sequence[complex], hz: Sequence[float], amplitude: Complex
) -> Array:
    """Level above threshold, dB, (case, finger): standard fingers at these positions first, then CASES sampled ones.

    hz, amplitude (actuator,): frequency, and complex amplitude as a fraction of full scale. Tones of different
    frequencies add in power.
    """
    deviations = _deviations(len(positions_m), CASES, axes_of(device.surface.corner_m))
    errors = PlantErrors.sample(device, CASES + 1)
    return _levels(modes, cases_at(np.array(positions_m), deviations, device), hz, amplitude, errors)


def standard_levels(
    device: Device, modes: Modes, positions_m: Sequence[complex], hz: Sequence[float], amplitude: Complex
) -> Array:
    """The first row of `compute_levels` alone, (finger,), in a thirtieth of its time."""
    fingers = len(positions_m)
    exact = Deviations(offset=np.zeros((1, fingers)), exponent=np.zeros((1, fingers, 3)))
    return _levels(modes, cases_at(np.array(positions_m), exact, device), hz, amplitude, None)[0]


def _levels(
    modes: Modes, cases: FingerCases, hz: Sequence[float], amplitude: Complex, errors: PlantErrors | None
) -> Array:
    power, tones = np.zeros(cases.position_m.shape), np.array(hz)
    for tone_hz in np.unique(tones[amplitude != 0]):
        if errors is None:
            response = _response(modes, cases, float(tone_hz))
        else:
            each = zip(cases.position_m, cases.impedance, tone_hz / errors.stretch, strict=True)
            alone = [(FingerCases(at_m[None], z[None]), at_hz) for at_m, z, at_hz in each]
            response = np.concatenate([_response(modes, one, at_hz) for one, at_hz in alone])
            response *= errors.channels(np.array([tone_hz])).swapaxes(1, 2)
        power += abs(response @ np.where(tones == tone_hz, amplitude, 0)) ** 2
    return 10 * np.log10(np.maximum(power, _LEAST_POWER))


def _response(modes: Modes, cases: FingerCases, hz: float) -> Complex:
    """Response over threshold (case, finger, actuator) at one frequency."""
    lines, weight = _neighbours(hz, modes.frequency_hz)
    return np.einsum("k,ckfa->cfa", weight, PlainLoading(modes, lines).loaded(cases))


def _neighbours(hz: float, grid_hz: Array) -> tuple[slice, Array]:
    """The lines next to a frequency, and the weights of the cubic through them."""
    first = int(np.clip(np.searchsorted(grid_hz, hz) - 2, 0, len(grid_hz) - _NEIGHBOURS))
    at_hz = grid_hz[first : first + _NEIGHBOURS]
    apart_hz = at_hz[:, None] - at_hz
    np.fill_diagonal(apart_hz, 1.0)
    off_hz = np.broadcast_to(hz - at_hz, apart_hz.shape).copy()
    np.fill_diagonal(off_hz, 1.0)
    return slice(first, first + _NEIGHBOURS), (off_hz / apart_hz).prod(axis=1)


class PlainLoading:
    """Loads the surface of one device at all frequencies of its modes, or at those of `lines` (indices)."""

    def __init__(self, modes: Modes, lines: slice = slice(None)) -> None:
        self._modes = modes = replace(
            modes,
            frequency_hz=modes.frequency_hz[lines],
            threshold_m_per_s2=modes.threshold_m_per_s2[lines],
            drive=modes.drive[..., lines],
        )
        self._omega = 2 * np.pi * modes.frequency_hz
        self._own = len(modes.natural_frequency_hz)

    def untouched(self, points_m: Points) -> Complex:
        """Response over threshold (..., line, actuator) at full scale at points (...,), no finger on the surface."""
        response = np.einsum("...m,mak->...ka", self._modes.at(points_m), self._modes.drive, optimize=True)
        return response * self._modes.per_threshold[:, None]

    def loaded(self, cases: FingerCases) -> Complex:
        """Response over threshold (case, line, finger, actuator) at full scale, all fingers on the surface."""
        free = self.untouched(cases.position_m).swapaxes(1, 2)
        coupled = np.array([self.receptances(each, each) for each in cases.position_m])
        coupled = np.eye(coupled.shape[2]) + coupled * self.impedance(cases)[:, :, None]
        return np.asarray(np.linalg.solve(coupled, free), dtype=np.complex128)

    def receptances(self, points_m: Points, others_m: Points) -> Complex:
        """Receptance (line, point, other), metres per newton, of the untouched surface."""
        modes = self._modes
        one, other = (modes.at(each)[..., : self._own] for each in (points_m, others_m))
        taken, also = (np.einsum("pm,mdk->kpd", shape, modes.damped, optimize=True) for shape in (one, other))
        return (one * modes.modal.T[:, None]) @ other.T - taken @ also.swapaxes(1, 2)

    def impedance(self, cases: FingerCases) -> Complex:
        """Force per displacement of each finger (case, line, finger)."""
        stiffness, damping, mass = np.moveaxis(cases.impedance[:, None], 3, 0)
        omega = self._omega[:, None]
        return stiffness + 1j * omega * damping - omega**2 * mass
