"""Gram matrices of the zones, R_z = omega^2 G^H Z_z G: localized factors follow from them."""

import numpy as np
from numba import prange, types

from base.arrays import Complex
from base.compiled import njit
from precompute.model.response import Response

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
