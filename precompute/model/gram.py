"""Gram matrices of the zones, R_z = omega^2 G^H Z_z G, and the steady state under a drive.

Localized factors follow from the matrices. The steady state has each zone's share of energy, peak and dead spot.
"""

from dataclasses import dataclass

import numpy as np
from numba import prange, types

from base.arrays import Array, Complex, Points
from base.compiled import njit
from precompute.model.plant import Plant
from precompute.model.response import Response, by_tone, solve_response

Gram = Complex

_FIELD = types.Array(types.complex128, 3, "C", readonly=True)
_INTEGRAL = types.Array(types.float64, 3, "C", readonly=True)
_INDEX = types.Array(types.int64, 1, "C", readonly=True)
_OUT = types.Array(types.complex128, 4, "C")


def compute_gram(response: Response) -> tuple[Gram, Gram]:
    """R_z = omega^2 G^H Z_z G (frequency, zone, actuator, actuator) and T over the whole surface, without that axis.

    Hermitian, proportional to the kinetic energy; the constants cancel in the localized factor, paper
    eq. (10) (docs/theory.md#tabulated-quantities). Zones need not cover the surface: then T is more than their sum.
    """
    power = (2 * np.pi * response.frequency_hz) ** 2
    out = response.plant.gram(response.displacement_m) * power[:, None, None, None]
    return np.ascontiguousarray(out[:, :-1]), out.sum(axis=1)


@njit(types.void(_FIELD, _INDEX, _INTEGRAL, _INDEX, _OUT), cache=True, parallel=True)
def fill_gram(field, first, integral, zone_of, out):  # type: ignore[no-untyped-def]  # numba
    """Add to out (frequency, zone, actuator, actuator) the exact integral over each element of conj(v_a) v_b.

    first (element,): of the four degrees of freedom that integral (element, 4, 4) is over.
    """
    count, actuators, _ = field.shape
    for f in prange(count):
        for e in range(integral.shape[0]):
            z = zone_of[e]
            for b in range(actuators):
                for i in range(4):
                    weighted = 0j
                    for j in range(4):
                        weighted += integral[e, i, j] * field[f, b, first[e] + j]
                    for a in range(actuators):
                        out[f, z, a, b] += np.conj(field[f, a, first[e] + i]) * weighted


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
