"""Banded solver for the dynamic stiffness K + j omega C - omega^2 M, at all frequencies in parallel (kernel)."""

import numpy as np
from numba import prange, types

from base.compiled import njit
from precompute.model.assembly import BANDWIDTH

FIRST_SUPER = 2 * BANDWIDTH  # Super-diagonals, with the fill-in of pivoting
BAND_ROWS = BANDWIDTH + FIRST_SUPER + 1
_BAND = types.Array(types.float64, 2, "C", readonly=True)
_VECTOR = types.Array(types.float64, 1, "C", readonly=True)
_WEIGHT = types.Array(types.float64, 2, "C", readonly=True)
_INDEX = types.Array(types.int64, 1, "C", readonly=True)
_OUT = types.Array(types.complex128, 3, "C")


@njit(cache=True)
def eliminate(lu, right):  # type: ignore[no-untyped-def]  # numba
    """Gaussian elimination with partial pivoting inside the band, then back substitution; in place."""
    size = lu.shape[0]
    count = right.shape[0]
    reach = 0  # the last column that row exchanges have filled so far
    for j in range(size):
        # Partial pivoting among the rows of the band below j.
        last = min(BANDWIDTH, size - 1 - j)
        pivot = 0
        for i in range(1, last + 1):
            if abs(lu[j, FIRST_SUPER + i]) > abs(lu[j, FIRST_SUPER + pivot]):
                pivot = i
        reach = max(reach, min(j + BANDWIDTH + pivot, size - 1))
        if pivot > 0:
            for column in range(j, reach + 1):
                upper, lower = FIRST_SUPER + j - column, FIRST_SUPER + j + pivot - column
                lu[column, upper], lu[column, lower] = lu[column, lower], lu[column, upper]
            for a in range(count):
                right[a, j], right[a, j + pivot] = right[a, j + pivot], right[a, j]
        # Eliminate column j from the rows below, in the matrix and in every right side.
        for i in range(1, last + 1):
            factor = lu[j, FIRST_SUPER + i] / lu[j, FIRST_SUPER]
            for column in range(j + 1, reach + 1):
                lu[column, FIRST_SUPER + j + i - column] -= factor * lu[column, FIRST_SUPER + j - column]
            for a in range(count):
                right[a, j + i] -= factor * right[a, j]
    # Back substitution, column by column.
    for j in range(size - 1, -1, -1):
        for a in range(count):
            right[a, j] /= lu[j, FIRST_SUPER]
            for row in range(max(0, j - FIRST_SUPER), j):
                right[a, row] -= lu[j, FIRST_SUPER + row - j] * right[a, j]


@njit(types.void(_BAND, _BAND, _BAND, _VECTOR, _INDEX, _WEIGHT, _VECTOR, _VECTOR, _OUT), cache=True, parallel=True)
def solve_banded(K, C, M, omega, dof, weight, spring, damper, out):  # type: ignore[no-untyped-def]  # numba
    """Fill out (frequency, load, degree of freedom); K, C, M upper bands.

    Load i is (spring_i + j omega damper_i) weight_i on the degrees of freedom from dof_i on, as many as have weight.
    """
    size = K.shape[1]
    for f in prange(omega.shape[0]):
        w = omega[f]
        lu = np.zeros((size, BAND_ROWS), dtype=np.complex128)  # lu[column, FIRST_SUPER + row - column]
        for column in range(size):
            for k in range(min(column, BANDWIDTH) + 1):
                row = column - k
                value = complex(
                    K[BANDWIDTH - k, column] - w * w * M[BANDWIDTH - k, column], w * C[BANDWIDTH - k, column]
                )
                lu[column, FIRST_SUPER - k] = value
                lu[row, FIRST_SUPER + k] = value
        right = out[f]
        right[:] = 0
        for a in range(dof.shape[0]):
            for i in range(weight.shape[1]):
                if weight[a, i] != 0.0:
                    right[a, dof[a] + i] = complex(spring[a], w * damper[a]) * weight[a, i]
        eliminate(lu, right)
