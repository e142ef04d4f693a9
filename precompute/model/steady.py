"""Steady state of the surface under a drive: share of energy, peak and dead spot of every zone, and where they are."""

from dataclasses import dataclass

import numpy as np

from base.arrays import Array, Complex, Points
from precompute.model.gram import compute_gram
from precompute.model.plant import Plant
from precompute.model.response import Response, by_tone, solve_response


@dataclass(frozen=True)
class SteadyState:
    """Per zone: share of kinetic energy, greatest and least acceleration (m/s^2), and at which points they are."""

    share: Array
    peak: Array
    peak_position_m: Points
    dead: Array
    dead_position_m: Points


def compute_steady_state(plant: Plant, frequency_hz: Array, amplitude: Complex) -> SteadyState:
    """Long-run figures of one tone an actuator: frequency_hz, amplitude (actuator,), complex fractions of full scale.

    Tones of one frequency add as fields, tones of different frequencies as magnitudes and energies
    (paper eqs. (8), (10); docs/theory.md#tabulated-quantities).
    """
    tones_hz, weight = by_tone(frequency_hz, amplitude)
    displacement_m = np.einsum("fa,fad->fd", weight, solve_response(plant, tones_hz).displacement_m)
    gram, total = compute_gram(Response(plant, tones_hz, np.ascontiguousarray(displacement_m[:, None])))
    share = (gram.sum(axis=0) / total.sum(axis=0))[:, 0, 0].real
    places_m = plant.zone_places_m
    omega = 2 * np.pi * tones_hz
    acceleration = plant.zone_sampler.sample(displacement_m) * (omega**2)[:, None]
    level = np.abs(acceleration).sum(axis=0).reshape(places_m.shape)
    peaks = [_peak(place_m, value) for place_m, value in zip(places_m, level, strict=True)]
    places_m, level = (each.reshape(len(each), -1) for each in (places_m, level))
    least, rows = level.argmin(axis=1), np.arange(len(level))
    return SteadyState(
        share=share,
        peak=np.array([height for height, _ in peaks]),
        peak_position_m=np.array([place for _, place in peaks]),
        dead=level[rows, least],
        dead_position_m=places_m[rows, least],
    )


def _peak(place_m: Points, value: Array) -> tuple[float, complex]:
    """Height and point of the maximum (across, along), by the parabolas through its neighbours in each direction."""
    row, column = np.unravel_index(value.argmax(), value.shape)
    height, at_m = float(value[row, column]), place_m[row, column]
    for course, way_m, k in ((value[row], place_m[row], column), (value[:, column], place_m[:, column], row)):
        if k in (0, len(course) - 1):
            continue
        left, middle, right = course[k - 1 : k + 2]
        curvature = left - 2 * middle + right
        shift = 0.5 * (left - right) / curvature if curvature < 0 else 0.0
        height -= 0.25 * float(left - right) * shift
        at_m = at_m + shift * (way_m[1] - way_m[0])
    return height, at_m.item()
