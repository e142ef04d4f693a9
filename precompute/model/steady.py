"""Steady state of the bar under a drive: share of energy, peak and dead spot of every zone, and where they are."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from precompute.model.assembly import Plant
from precompute.model.gram import compute_gram
from precompute.model.response import Response, by_tone, solve_response

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class SteadyState:
    """Per zone: share of kinetic energy, greatest and least acceleration (m/s^2) and where (m from the start)."""

    share: Array
    peak: Array
    peak_position_m: Array
    dead: Array
    dead_position_m: Array


def compute_steady_state(plant: Plant, frequency_hz: Array, amplitude: Complex) -> SteadyState:
    """Long-run figures of one tone an actuator: frequency_hz, amplitude (actuator,), complex fractions of full scale.

    Tones of one frequency add as fields, tones of different frequencies as magnitudes and energies
    (paper eqs. (8), (10); docs/theory.md#tabulated-quantities).
    """
    tones, weight = by_tone(frequency_hz, amplitude)
    response = solve_response(plant, tones)
    return steady_state_of(plant, tones, np.einsum("fa,fad->fd", weight, response.displacement_m))


def steady_state_of(plant: Plant, tones_hz: Array, displacement_m: Complex) -> SteadyState:
    """The steady state of a known field, displacement_m (tone, degree of freedom)."""
    field = Response(plant, tones_hz, np.ascontiguousarray(displacement_m[:, None]))
    gram, total = compute_gram(field)
    share = (gram.sum(axis=0) / total.sum(axis=0))[:, 0, 0].real
    places_m = plant.zone_places_m
    omega = 2 * np.pi * tones_hz
    acceleration = plant.zone_sampler.sample(displacement_m) * (omega**2)[:, None]
    level = np.abs(acceleration).sum(axis=0).reshape(places_m.shape)
    peaks = [_peak(place_m, value) for place_m, value in zip(places_m, level, strict=True)]
    least, rows = level.argmin(axis=1), np.arange(len(level))
    return SteadyState(
        share=share,
        peak=np.array([height for height, _ in peaks]),
        peak_position_m=np.array([place for _, place in peaks]),
        dead=level[rows, least],
        dead_position_m=places_m[rows, least],
    )


def _peak(place: Array, value: Array) -> tuple[float, float]:
    """Height and place of the maximum, by the parabola through its neighbours."""
    k = int(value.argmax())
    if k in (0, len(value) - 1):
        return float(value[k]), float(place[k])
    left, middle, right = value[k - 1 : k + 2]
    curvature = left - 2 * middle + right
    shift = 0.5 * (left - right) / curvature if curvature < 0 else 0.0
    return float(middle - 0.25 * (left - right) * shift), float(place[k] + shift * (place[1] - place[0]))
