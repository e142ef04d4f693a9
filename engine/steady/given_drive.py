"""Responses and levels under fingers at any positions, of a steady drive that is given, in NumPy.

The drive is any that a device was sent: each actuator has its frequency. The solver states levels over the few cases
that it optimises for, these are over more, of the same spread. Responses are interpolated over frequency and place as
the solver interpolates them (engine.steady.drive_search). All fingers of a case are attached at once, by one small
system of equations. `engine.steady.loading` does the same by compiled kernels.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from base.arrays import Array, Complex, Points
from engine.device import Device
from engine.steady.cases import Deviations, FingerCases, PlantErrors, axes_of, cases_at, sample_deviations
from engine.steady.modes import Modes
from engine.touch.placement import MOST_FINGERS

CASES = 32  # as many as `tactable explain` takes for fingers at positions
_NEIGHBOURS = 4
_LEAST_POWER = 1e-30  # -300 dB, as in steady_drive.py: silence has a logarithm
_deviations = lru_cache(maxsize=MOST_FINGERS)(sample_deviations)


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
