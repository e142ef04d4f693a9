"""A plant whose untouched surface moves as it was measured, while its fingers follow the model.

Cubic splines interpolate between frequencies, and the least bent fields between places: on a bar natural splines.
The model gives what a force at a finger does to the bar, and the rise times. ESTIMATE: no better than the calibration.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from base.arrays import Array, Complex, Mask
from engine.device import Device
from precompute.measurements.response_table import MeasuredResponses
from precompute.model.assembly import assemble
from precompute.model.plant import Plant
from precompute.model.response import solve_response


@dataclass(frozen=True)
class MeasuredDrive:
    """What is known of a surface whose response to its actuators was measured.

    between (degree of freedom, place): fields of the plant that are 1 at one of the measured places (`Plant.through`).
    """

    responses: MeasuredResponses
    between: Array

    def at(self, frequency_hz: Array) -> tuple[Array, Complex]:
        """The fields between the measured places, and the displacements at these (`Plant.known_drive`)."""
        displacement: Complex = -self._over_frequency(frequency_hz) / (2 * np.pi * frequency_hz[:, None, None]) ** 2
        return self.between, displacement.transpose(2, 1, 0)

    @cached_property
    def _over_frequency(self) -> "CubicSpline[np.complex128]":
        """Spline over frequency of accelerations (actuator, place), m/s^2."""
        return CubicSpline(self.responses.frequency_hz, self.responses.acceleration)


def measured_plant(device: Device, responses: MeasuredResponses) -> Plant:
    """Assemble the plant of a device whose responses were measured."""
    plant = assemble(device)
    known = MeasuredDrive(responses, plant.through(responses.position_m))
    return replace(plant, known=known)  # type: ignore[type-var]  # every plant is a dataclass


@dataclass(frozen=True)
class InterpolationErrors:
    """Errors (actuator,) relative to the greatest response at the frequency. ESTIMATE.

    between_frequencies, between_places: greatest error, at the samples left out, of interpolation through the others;
    an upper bound for that through all. model: median over the frequencies of the distance between model and
    measurement, root mean square over the places; where it is large, what the model contributes is wrong as well.
    """

    between_frequencies: Array
    between_places: Array
    model: Array


def estimate_errors(device: Device, responses: MeasuredResponses) -> InterpolationErrors:
    """Compare splines through every other frequency and place with the others, and the model with all."""
    measured, hz, place_m = responses.acceleration, responses.frequency_hz, responses.position_m
    size = abs(measured).max(axis=2, keepdims=True)
    # Leave out every other frequency. Leave out every other place of a bar, every fourth of a plate.
    left_hz, left_m = slice(1, len(hz) - 1, 2), slice(1, len(place_m) - 1, 4 if np.iscomplexobj(place_m) else 2)
    kept_hz, kept_m = _without(len(hz), left_hz), _without(len(place_m), left_m)
    between_hz = CubicSpline(hz[kept_hz], measured[kept_hz])(hz[left_hz]) - measured[left_hz]
    plant = assemble(device)
    matrix = plant.sampler(place_m[left_m]).shapes(plant.through(place_m[kept_m]))
    between_m = measured[..., kept_m] @ matrix.T - measured[..., left_m]
    modelled = solve_response(plant, hz).acceleration(place_m)
    distance = np.sqrt((abs(modelled - measured) ** 2).mean(axis=2) / (abs(measured) ** 2).mean(axis=2))
    return InterpolationErrors(
        between_frequencies=(abs(between_hz) / size[left_hz]).max(axis=(0, 2)),
        between_places=(abs(between_m) / size).max(axis=(0, 2)),
        model=np.median(distance, axis=0),
    )


def _without(count: int, left_out: slice) -> Mask:
    kept = np.ones(count, dtype=np.bool_)
    kept[left_out] = False
    return kept
