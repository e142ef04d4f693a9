"""Receptances of a plant at even places along its bar, which drives at any positions are solved from."""

import numpy as np
from numpy.typing import NDArray

from engine.steady.receptances import Receptances
from precompute.model.assembly import Plant
from precompute.model.frequencies import add_resonances
from precompute.model.modal import Basis, compute_modal_model
from precompute.model.transfers import transfers_at

Array = NDArray[np.float64]

PITCH_M = 5e-3
"""Largest distance of neighbouring places (docs/theory.md#steady-drives-at-positions says what it costs)."""
_FEWEST = 5  # a cubic needs four; the bar's middle is then a place
_CHUNK = 64  # frequencies at a time: fields of 60 places in 256 elements take 32 MB


def solve_place_receptances(plant: Plant, frequency_hz: Array, pitch_m: float = PITCH_M) -> Receptances:
    """Solve the untouched bar once for each actuator and each place; the places are `pitch_m` apart at most."""
    length_m, actuators = plant.device.bar.length_m, len(plant.device.actuators)
    place_m = _places_m(length_m, pitch_m)
    row, column = np.triu_indices(len(place_m))
    drive = np.empty((len(place_m), actuators, len(frequency_hz)), dtype=np.complex64)
    point = np.empty((len(row), len(frequency_hz)), dtype=np.complex64)
    from precompute.model.response import solve_response  # compiles a kernel, which modal receptances do without

    sampler = plant.sampler(place_m)
    for start in range(0, len(frequency_hz), _CHUNK):
        part = slice(start, start + _CHUNK)
        at_places = sampler.sample(solve_response(plant, frequency_hz[part], place_m).displacement_m)
        drive[:, :, part] = at_places[:, :actuators].transpose(2, 1, 0)
        point[:, part] = at_places[:, actuators + row, column].T
    threshold_m_per_s2 = plant.device.threshold.peak_m_per_s2(frequency_hz)
    return Receptances(frequency_hz, threshold_m_per_s2, place_m, drive, point)


def modal_receptances(basis: Basis) -> Receptances:
    """Receptances of the untouched bar at even places, from sums of its modes: without a compiled kernel.

    Frequencies are those of the sweep, and the resonances of the bar untouched and under fingers in its zones.
    """
    plant = basis.plant
    device, count = plant.device, len(basis.square_omega)
    middles_m = [(zone.start_m + zone.stop_m) / 2 for zone in device.zones]
    loads = [[], [(at_m, device.finger) for at_m in middles_m], *([(at_m, device.finger)] for at_m in middles_m)]
    models = [compute_modal_model(basis, load) for load in loads]
    frequency_hz = add_resonances(device, device.sweep.frequency_hz, np.concatenate([each.pole for each in models]))
    place_m = _places_m(device.bar.length_m, PITCH_M)
    shape = basis.at(place_m)
    s = 2j * np.pi * frequency_hz[:, None, None]
    inverse = np.linalg.inv(np.diag(basis.square_omega) + s**2 * np.eye(count) + s * basis.damping)
    spread = shape @ inverse  # (frequency, place, mode)
    push, transfers = models[0].push, transfers_at(device.actuators, s[:, 0, 0])
    force = push[:, 0] + s * push[:, 1]
    if transfers is not None:
        force = force * transfers[:, None]
    row, column = np.triu_indices(len(place_m))
    return Receptances(
        frequency_hz=frequency_hz,
        threshold_m_per_s2=device.threshold.peak_m_per_s2(frequency_hz),
        place_m=place_m,
        drive=np.ascontiguousarray((spread @ force).transpose(1, 2, 0), dtype=np.complex64),
        point=np.ascontiguousarray((spread @ shape.T)[:, row, column].T, dtype=np.complex64),
    )


def _places_m(length_m: float, pitch_m: float) -> Array:
    return np.linspace(0.0, length_m, max(int(np.ceil(length_m / pitch_m - 1e-9)) + 1, _FEWEST))
