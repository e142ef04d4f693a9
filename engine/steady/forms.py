"""Kernels on Hermitian forms in packed real parts: what a drive's power, its level and its limits are computed from.

A form H (part,) holds the diagonal, then the real and imaginary part of every element above it, row by row. A drive a
has the products S (part,) such that a^H H a is the scalar product of both: one multiplication for each part, in a loop
without branches. Products of the diagonal are the powers of the amplitudes themselves.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import types

from base.compiled import njit

TINY = 1e-300  # near the least normal double: against division by 0 and the logarithm of 0

ROW = types.Array(types.float64, 1, "A", readonly=True)
ROWS = types.Array(types.float64, 2, "A", readonly=True)
REAL = types.Array(types.float64, 1, "C")
DRIVE = types.Array(types.complex128, 1, "C")
USABLE = types.Array(types.boolean, 1, "A", readonly=True)


def kernel(signature: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a kernel of this package ahead, for the types of `signature`; its machine code is kept."""
    return njit(signature, cache=True, error_model="numpy")


@kernel(types.void(DRIVE, DRIVE))
def copy_drive(a, out):  # type: ignore[no-untyped-def]  # numba
    """Fill out (actuator,) with a drive; numba's slice assignment compiles seconds of error text for it."""
    for i in range(len(a)):
        out[i] = a[i]


@kernel(types.void(DRIVE, REAL))
def fill_products(a, out):  # type: ignore[no-untyped-def]  # numba
    """Fill out (part,) with the products of a drive (actuator,)."""
    m = len(a)
    part = m
    for i in range(m):
        out[i] = a[i].real * a[i].real + a[i].imag * a[i].imag
        for j in range(i + 1, m):
            out[part] = 2.0 * (a[i].real * a[j].real + a[i].imag * a[j].imag)
            out[part + 1] = -2.0 * (a[i].real * a[j].imag - a[i].imag * a[j].real)
            part += 2


@kernel(types.float64(ROW, REAL))
def power_of(form, products):  # type: ignore[no-untyped-def]  # numba
    """The power a^H H a."""
    total = 0.0
    for i in range(len(products)):
        total += form[i] * products[i]
    return total


@kernel(types.void(ROW, DRIVE, DRIVE))
def multiply(form, a, out):  # type: ignore[no-untyped-def]  # numba
    """Fill out (actuator,) with H a."""
    m = len(a)
    part = m
    for i in range(m):
        out[i] = form[i] * a[i]
    for i in range(m):
        for j in range(i + 1, m):
            element = complex(form[part], form[part + 1])
            out[i] += element * a[j]
            out[j] += np.conj(element) * a[i]
            part += 2


@kernel(types.void(ROW, DRIVE, DRIVE, types.Array(types.complex128, 2, "C")))
def solve(form, b, x, lower):  # type: ignore[no-untyped-def]  # numba
    """Fill x (actuator,) with a multiple of H^-1 b, by Cholesky's factors in lower (actuator, actuator).

    A pivot below 1e-12 of the trace is raised to it: a form of few cases may be singular.
    """
    m = len(b)
    if m == 2:  # the adjugate, which needs no factor
        element = complex(form[2], form[3])
        x[0] = form[1] * b[0] - element * b[1]
        x[1] = form[0] * b[1] - np.conj(element) * b[0]
        return
    trace = 0.0
    part = m
    for i in range(m):
        trace += form[i]
        lower[i, i] = form[i]
        for j in range(i + 1, m):
            lower[j, i] = complex(form[part], -form[part + 1])
            part += 2
    floor = max(1e-12 * trace, TINY)
    for j in range(m):
        pivot = lower[j, j].real
        for k in range(j):
            pivot -= lower[j, k].real ** 2 + lower[j, k].imag ** 2
        root = np.sqrt(max(pivot, floor))
        lower[j, j] = root
        for i in range(j + 1, m):
            s = lower[i, j]
            for k in range(j):
                s -= lower[i, k] * np.conj(lower[j, k])
            lower[i, j] = s / root
    for i in range(m):
        s = b[i]
        for k in range(i):
            s -= lower[i, k] * x[k]
        x[i] = s / lower[i, i].real
    for i in range(m - 1, -1, -1):
        for k in range(i + 1, m):
            x[i] -= np.conj(lower[k, i]) * x[k]
        x[i] /= lower[i, i].real


@kernel(types.void(ROW, types.Array(types.complex128, 2, "C")))
def invert(form, out):  # type: ignore[no-untyped-def]  # numba
    """Fill out (actuator, actuator) with H^-1, by elimination (Gauss and Jordan). A pivot is raised as in `solve`."""
    m = len(out)
    trace, part = 0.0, m
    for i in range(m):
        trace += form[i]
        out[i, i] = form[i]
        for j in range(i + 1, m):
            out[i, j] = complex(form[part], form[part + 1])
            out[j, i] = np.conj(out[i, j])
            part += 2
    floor = max(1e-12 * trace, TINY)
    for k in range(m):
        pivot = 1.0 / max(out[k, k].real, floor)
        for i in range(m):
            if i != k:
                factor = out[i, k] * pivot
                for j in range(m):
                    if j != k:
                        out[i, j] -= factor * out[k, j]
                out[i, k] = -factor
        for j in range(m):
            out[k, j] *= pivot
        out[k, k] = pivot


@kernel(types.float64(ROWS, types.int64, types.int64, REAL))
def ratio_of(forms, felt, quiet, products):  # type: ignore[no-untyped-def]  # numba
    """The weakest of the first `felt` powers over the strongest of the `quiet` ones after them."""
    least, greatest = np.inf, TINY
    for i in range(felt):
        least = min(least, power_of(forms[i], products))
    for i in range(felt, felt + quiet):
        greatest = max(greatest, power_of(forms[i], products))
    return max(least, 0.0) / greatest


@kernel(types.float64(ROWS, types.int64, types.int64, REAL))
def loudness_of(forms, first, m, products):  # type: ignore[no-untyped-def]  # numba
    """The weakest power of the forms from `first` on, with the strongest of m actuators at 1."""
    least, greatest = np.inf, TINY
    for i in range(first, len(forms)):
        least = min(least, power_of(forms[i], products))
    for i in range(m):
        greatest = max(greatest, products[i])
    return least / greatest
