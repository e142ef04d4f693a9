"""Receptance of the untouched bar at every place where a sampled finger may lie, and its zone energies."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from precompute.model.assembly import Plant
from precompute.model.gram import compute_gram
from precompute.model.response import Response, solve_response
from precompute.sampling.fingers import SampledFingers

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_CHUNK = 64  # frequencies at a time: fields of 60 places in 256 elements take 32 MB


@dataclass(frozen=True)
class Receptance:
    """Displacements at the touched places, and energies, of the untouched bar.

    drive (frequency, place, actuator): metres at full scale; point (frequency, place, place): metres per newton; place
    counts through zones, then places in each. zone_gram (frequency, zone, column, column) and total_gram (frequency,
    column, column): Gram matrices (model.gram) of one column an actuator, then one a finger at a zone's middle.
    """

    plant: Plant
    sampled: SampledFingers
    frequency_hz: Array
    drive: Complex
    point: Complex
    zone_gram: Complex
    total_gram: Complex


def solve_receptance(plant: Plant, sampled: SampledFingers, frequency_hz: Array) -> Receptance:
    """Solve the untouched bar once for each actuator and each place; any case follows without another solve."""
    actuators, zones = len(plant.device.actuators), len(plant.device.zones)
    places = sampled.position_m.size
    count, columns = len(frequency_hz), actuators + zones
    drive = np.empty((count, places, actuators), dtype=np.complex128)
    point = np.empty((count, places, places), dtype=np.complex128)
    zone_gram = np.empty((count, zones, columns, columns), dtype=np.complex128)
    total_gram = np.empty((count, columns, columns), dtype=np.complex128)
    sampler = plant.sampler(sampled.position_m.ravel())
    middles = actuators + np.arange(zones) * sampled.position_m.shape[1] + sampled.position_m.shape[1] // 2
    kept = np.concatenate([np.arange(actuators), middles])
    for start in range(0, count, _CHUNK):
        part = slice(start, start + _CHUNK)
        response = solve_response(plant, frequency_hz[part], sampled.position_m.ravel())
        at_places = sampler.sample(response.displacement_m).transpose(0, 2, 1)
        drive[part], point[part] = at_places[:, :, :actuators], at_places[:, :, actuators:]
        few = Response(plant, response.frequency_hz, response.displacement_m[:, kept])
        zone_gram[part], total_gram[part] = compute_gram(few)
    return Receptance(plant, sampled, frequency_hz, drive, point, zone_gram, total_gram)
