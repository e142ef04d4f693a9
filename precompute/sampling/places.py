"""Receptances of a plant at even places along its bar, which drives at any positions are solved from."""

import numpy as np
from numpy.typing import NDArray

from engine.steady.receptances import Receptances
from precompute.model.assembly import Plant
from precompute.model.response import solve_response

Array = NDArray[np.float64]

PITCH_M = 5e-3
"""Largest distance of neighbouring places (docs/theory.md#steady-drives-at-positions says what it costs)."""
_FEWEST = 5
_CHUNK = 64  # frequencies at a time: fields of 60 places in 256 elements take 32 MB


def solve_place_receptances(plant: Plant, frequency_hz: Array, pitch_m: float = PITCH_M) -> Receptances:
    """Solve the untouched bar once for each actuator and each place; the places are `pitch_m` apart at most."""
    length_m, actuators = plant.device.bar.length_m, len(plant.device.actuators)
    places = max(int(np.ceil(length_m / pitch_m - 1e-9)) + 1, _FEWEST)
    place_m = np.linspace(0.0, length_m, places)
    row, column = np.triu_indices(places)
    drive = np.empty((places, actuators, len(frequency_hz)), dtype=np.complex64)
    point = np.empty((len(row), len(frequency_hz)), dtype=np.complex64)
    sampler = plant.sampler(place_m)
    for start in range(0, len(frequency_hz), _CHUNK):
        part = slice(start, start + _CHUNK)
        at_places = sampler.sample(solve_response(plant, frequency_hz[part], place_m).displacement_m)
        drive[:, :, part] = at_places[:, :actuators].transpose(2, 1, 0)
        point[:, part] = at_places[:, actuators + row, column].T
    threshold_m_per_s2 = plant.device.threshold.peak_m_per_s2(frequency_hz)
    return Receptances(frequency_hz, threshold_m_per_s2, place_m, drive, point)
