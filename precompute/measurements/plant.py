"""A plant whose untouched bar moves as it was measured, while its fingers follow the model.

Natural cubic splines interpolate between frequencies and between places: the ends of a free bar have no curvature.
The model gives what a force at a finger does to the bar, and the rise times. ESTIMATE: no better than the calibration.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from base.arrays import Array, Complex, Mask
from engine.device import Device, Finger
from precompute.measurements.response_table import MeasuredResponses
from precompute.model.assembly import BarPlant, assemble_bar
from precompute.model.response import solve_response


@dataclass(frozen=True)
class MeasuredPlant(BarPlant):
    """A plant whose response to its actuators was measured."""

    responses: MeasuredResponses

    @property
    def is_measured(self) -> bool:
        """Whether the responses were measured: always."""
        return True

    def known_drive(self, frequency_hz: Array) -> tuple[Array, Complex]:
        """Splines that are 1 at one of the measured places, and the displacements there."""
        displacement: Complex = -self._over_frequency(frequency_hz) / (2 * np.pi * frequency_hz[:, None, None]) ** 2
        return self._along_bar, displacement.transpose(2, 1, 0)

    def with_fingers(self, position_m: Sequence[complex], finger: Finger | Sequence[Finger]) -> BarPlant:
        """Raises ValueError: the bar was measured without fingers; predict.performance adds them to its response."""
        raise ValueError(f"{finger} at {position_m} cannot be assembled into measured responses")

    @cached_property
    def _over_frequency(self) -> "CubicSpline[np.complex128]":
        """Spline over frequency of accelerations (actuator, place), m/s^2."""
        return CubicSpline(self.responses.frequency_hz, self.responses.acceleration)

    @cached_property
    def _along_bar(self) -> Array:
        """Shape (degree of freedom, place): deflection and slope at every node from those at the measured places."""
        return _spline_matrix(self.responses.position_m, self.node_m)


def _spline_matrix(place_m: Array, node_m: Array) -> Array:
    """Deflections and slopes of a natural spline through values at places, straight beyond the outermost places."""
    spline = CubicSpline(place_m, np.eye(len(place_m)), bc_type="natural")
    inside_m = np.clip(node_m, place_m[0], place_m[-1])
    slope = spline(inside_m, 1)
    out = np.empty((2 * len(node_m), len(place_m)))
    out[0::2] = spline(inside_m) + (node_m - inside_m)[:, None] * slope
    out[1::2] = slope
    return out


def measured_plant(device: Device, responses: MeasuredResponses) -> MeasuredPlant:
    """Assemble the plant of a device whose responses were measured."""
    plant = assemble_bar(device)
    return MeasuredPlant(device, plant.node_m, plant.K, plant.C, plant.M, responses)


@dataclass(frozen=True)
class InterpolationErrors:
    """Errors (actuator,) relative to the greatest response at the frequency. ESTIMATE.

    between_frequencies, between_places: greatest error, at the samples left out, of splines through every other sample;
    an upper bound for splines through all. model: median over the frequencies of the distance between model and
    measurement, root mean square over the places; where it is large, what the model contributes is wrong as well.
    """

    between_frequencies: Array
    between_places: Array
    model: Array


def estimate_errors(device: Device, responses: MeasuredResponses) -> InterpolationErrors:
    """Compare splines through every other frequency and place with the others, and the model with all."""
    measured, hz, place_m = responses.acceleration, responses.frequency_hz, responses.position_m
    size = abs(measured).max(axis=2, keepdims=True)
    left_hz, left_m = slice(1, len(hz) - 1, 2), slice(1, len(place_m) - 1, 2)
    kept_hz, kept_m = _without(len(hz), left_hz), _without(len(place_m), left_m)
    between_hz = CubicSpline(hz[kept_hz], measured[kept_hz])(hz[left_hz]) - measured[left_hz]
    matrix = _spline_matrix(place_m[kept_m], place_m[left_m])[0::2]
    between_m = measured[..., kept_m] @ matrix.T - measured[..., left_m]
    modelled = solve_response(assemble_bar(device), hz).acceleration(place_m)
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
