"""Modes of a plant at even places over its surface, which drives at any positions are solved from."""

from dataclasses import replace

import numpy as np

from base.arrays import Array, even_points
from engine.steady.modes import Modes
from engine.touch.placement import Places
from precompute.model.frequencies import add_resonances
from precompute.model.modal import Basis, compute_basis, compute_modal_model, mount_dampers
from precompute.model.plant import Plant
from precompute.model.response import blocked_force

PITCH_M = 5e-3  # largest distance of neighbouring places (docs/theory.md#steady-drives-at-positions says what it costs)
_TIMES_SWEEP, _FEWEST_MODES, _MOST_MODES = 32.0, 40, 150
_MOST_LINES = 600
"""reference-a has 353, reference-t 438, plates 821 and 1180. The grid alone is searched three times as fast, and costs
0.0 dB of contrast (median of 60 pairs of a felt and a quiet finger), 5 of 49 in one of twenty (reference-p, 20 dB)."""
_FEWEST_STEPS = 4  # along a side, so that its middle is a place; a cubic needs three


def steady_basis(plant: Plant) -> Basis:
    """The modes that drives are solved from: those up to 32 times the sweep, on a bar twice what rise times need."""
    basis = compute_basis(plant, _MOST_MODES)
    count = np.searchsorted(basis.square_omega, (2 * np.pi * _TIMES_SWEEP * plant.device.sweep.stop_hz) ** 2)
    return basis.lowest(max(int(count), _FEWEST_MODES))


def search_frequencies(basis: Basis) -> Array:
    """The grid of the device, with the resonances of the surface untouched and under fingers in its zones.

    Without them where they are too many, as on plates: drives play frequencies of the grid alone there.
    """
    device = basis.plant.device
    middles_m = [zone.middle_m for zone in device.zones]
    loads = [[], [(at_m, device.finger) for at_m in middles_m], *([(at_m, device.finger)] for at_m in middles_m)]
    pole = np.concatenate([compute_modal_model(basis, load).pole for load in loads])
    dense_hz = add_resonances(device, device.sweep.frequency_hz, pole)
    return dense_hz if len(dense_hz) <= _MOST_LINES else device.sweep.frequency_hz


def steady_modes(basis: Basis, frequency_hz: Array | None = None) -> Modes:
    """The modes of a basis at even places, without a compiled kernel; frequencies are those of the search.

    Where the drive was measured, the modes give what fingers do, and the functions that were measured the drive.
    """
    plant, device = basis.plant, basis.plant.device
    hz = search_frequencies(basis) if frequency_hz is None else frequency_hz
    corner_m, surface = device.surface.corner_m, device.surface
    steps_m = [side_m / _FEWEST_STEPS for side_m in (corner_m.real, corner_m.imag) if side_m]
    places = Places.every(corner_m, min(PITCH_M, *steps_m))
    sampler = plant.sampler(even_points(0 * corner_m, corner_m, places.along, places.across))  # row by row
    modes = Modes(
        frequency_hz=hz,
        threshold_m_per_s2=device.threshold.peak_m_per_s2(hz),
        places=places,
        shape=sampler.shapes(basis.shape).astype(np.float32),
        drive=np.zeros((len(basis.square_omega), len(device.actuators), len(hz)), dtype=np.complex64),
        natural_frequency_hz=np.sqrt(basis.square_omega) / (2 * np.pi),
        damping_per_s=surface.mass_damping_per_s + surface.stiffness_damping_s * basis.square_omega,
        at_actuator=basis.at_actuators.T,
        damper_n_s_per_m=mount_dampers(basis),
    )
    known = plant.known_drive(hz)
    if known is None:
        force = blocked_force(device.actuators, hz).T
        return replace(modes, drive=(modes.moved_at_actuators() * force).astype(np.complex64))
    shape, measured = known
    return replace(
        modes,
        shape=np.concatenate([modes.shape, sampler.shapes(shape).astype(np.float32)], axis=1),
        drive=np.concatenate([modes.drive, measured.astype(np.complex64)]),
    )
