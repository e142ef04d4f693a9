"""Measured responses to a plant: its untouched bar moves as it was measured, its fingers are the model's.

Between places and between frequencies natural cubic splines are laid: a free bar's ends have no curvature. What a force
at a finger does to the bar is the model's, and so are rise times. ESTIMATE: as good as the model is calibrated.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from engine.device import Device, Finger
from precompute.measurements.responses import MeasuredResponses
from precompute.model.assembly import Plant, assemble
from precompute.model.response import solve_response

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class MeasuredPlant(Plant):
    """A plant whose response to its actuators is known."""

    responses: MeasuredResponses

    def known_field(self, frequency_hz: Array) -> Complex:
        """As measured."""
        acceleration: Complex = self._over_frequency(frequency_hz)
        omega = 2 * np.pi * frequency_hz[:, None, None]
        field: Complex = -(acceleration / omega**2) @ self._along_bar.T
        return field

    def with_fingers(self, position_m: Sequence[float], finger: Finger | Sequence[Finger]) -> Plant:
        """Raises ValueError: nobody measured the bar with fingers; entries.forms adds them to its response."""
        raise ValueError(f"{finger} at {position_m} cannot be assembled into measured responses")

    @cached_property
    def _over_frequency(self) -> "CubicSpline[np.complex128]":
        """(frequency, actuator, place), m/s^2."""
        return CubicSpline(self.responses.frequency_hz, self.responses.acceleration)

    @cached_property
    def _along_bar(self) -> Array:
        """Shape (degree of freedom, place): deflection and slope at every node from those at the measured places."""
        return _spline_matrix(self.responses.position_m, self.node_m)


def _spline_matrix(place_m: Array, node_m: Array) -> Array:
    """Deflections and slopes of a natural spline through values at places; beyond the outer ones it is straight."""
    spline = CubicSpline(place_m, np.eye(len(place_m)), bc_type="natural")
    inside_m = np.clip(node_m, place_m[0], place_m[-1])
    slope = spline(inside_m, 1)
    out = np.empty((2 * len(node_m), len(place_m)))
    out[0::2] = spline(inside_m) + (node_m - inside_m)[:, None] * slope
    out[1::2] = slope
    return out


def measured_plant(device: Device, responses: MeasuredResponses) -> MeasuredPlant:
    """The plant of a device whose responses were measured."""
    plant = assemble(device)
    return MeasuredPlant(device, plant.node_m, plant.K, plant.C, plant.M, responses)


@dataclass(frozen=True)
class Doubts:
    """How far measured responses can be trusted; each (actuator,), relative to the greatest measured at the frequency.

    Of what splines read between frequencies and places, upper bounds: the greatest error of splines through every other
    one, at those left out. ESTIMATE. model: median over the frequencies of how far the model is from the measured
    responses, root mean square over the places; where it is far, what is the model's is wrong too.
    """

    between_frequencies: Array
    between_places: Array
    model: Array


def doubt(device: Device, responses: MeasuredResponses) -> Doubts:
    """Splines of every other frequency and place against those left out, and the model against all."""
    measured, hz, place_m = responses.acceleration, responses.frequency_hz, responses.position_m
    size = abs(measured).max(axis=2, keepdims=True)
    left_hz, left_m = slice(1, len(hz) - 1, 2), slice(1, len(place_m) - 1, 2)
    kept_hz, kept_m = _without(len(hz), left_hz), _without(len(place_m), left_m)
    between_hz = CubicSpline(hz[kept_hz], measured[kept_hz])(hz[left_hz]) - measured[left_hz]
    matrix = _spline_matrix(place_m[kept_m], place_m[left_m])[0::2]
    between_m = measured[..., kept_m] @ matrix.T - measured[..., left_m]
    modelled = solve_response(assemble(device), hz).acceleration(place_m)
    distance = np.sqrt((abs(modelled - measured) ** 2).mean(axis=2) / (abs(measured) ** 2).mean(axis=2))
    return Doubts(
        between_frequencies=(abs(between_hz) / size[left_hz]).max(axis=(0, 2)),
        between_places=(abs(between_m) / size).max(axis=(0, 2)),
        model=np.median(distance, axis=0),
    )


def _without(count: int, left_out: slice) -> NDArray[np.bool_]:
    kept = np.ones(count, dtype=np.bool_)
    kept[left_out] = False
    return kept
