"""Kernels: the best drive at one frequency, from forms in packed real parts (engine.steady.forms).

A drive a (actuator,) has felt powers N_i, quiet ones D_j and levels P_f. Maximise min N / max D subject to
min_f P_f >= wanted max_l |a_l|^2:

- One felt and one quiet form: the greatest eigenvalue of N a = lambda D a; closed form for two actuators, power
  iteration beyond. N is nearly of rank one (one finger, a few cases of it), so two or three steps are enough.
- Several fingers: the forms of each side are added with weights, and the weights of the weakest felt and the strongest
  quiet finger grow step by step, by the ratio by which each is weak or strong (Lawson 1961). The drive takes one step
  of the power iteration for each step of the weights, so it follows from frequency to frequency.
- Where that is not loud enough: engine.steady.limited. What is left to the level is found along the line to the loudest
  drive; the ascent (engine.steady.ascent) climbs from there.

Forms (form, part) are `felt` numerators, `quiet` denominators, and the levels, one after another; p (finger, actuator)
holds the responses that the levels are the powers of.
"""

import numpy as np
from numba import types

from engine.steady.forms import (
    DRIVE,
    REAL,
    ROW,
    ROWS,
    TINY,
    USABLE,
    copy_drive,
    fill_products,
    kernel,
    loudness_of,
    multiply,
    power_of,
    ratio_of,
    solve,
)

_CONVERGED = 1e-7  # relative; 1e-5 loses nothing in the placements that drive_search.py tells of
_LOUD_STEPS = 8
_LINE_STEPS = 12  # halvings; 6 lose 0.04 dB at most (drive_search.py)
_LEAST_WEIGHT = 1e-4  # so that it can grow again; 1e-2 changes contrasts by -1.2 to 1.0 dB (drive_search.py)

_RESPONSES = types.Array(types.complex128, 2, "C")
_SPACE = types.Array(types.complex128, 2, "C")
_MIXED = types.Array(types.float64, 2, "C")


@kernel(types.void(DRIVE, DRIVE))
def _normalise(vector, a):  # type: ignore[no-untyped-def]  # numba
    """Let `a` be the vector at length 1; it stays as it is where the vector is 0."""
    size = 0.0
    for i in range(len(a)):
        size += vector[i].real ** 2 + vector[i].imag ** 2
    if size > 0.0:
        scale = 1.0 / np.sqrt(size)
        for i in range(len(a)):
            a[i] = vector[i] * scale


@kernel(types.float64(ROW, ROW, DRIVE, types.int64))
def solve_dominant(N, D, a, steps):  # type: ignore[no-untyped-def]  # numba
    """The greatest lambda of N a = lambda D a and its a in place, by at most `steps` power iterations from `a`."""
    m = len(a)
    if m == 1:
        a[0] = 1.0
        return N[0] / max(D[0], TINY)
    if m == 2:
        d = max(D[0] * D[1] - D[2] * D[2] - D[3] * D[3], 1e-24 * (D[0] + D[1]) ** 2)
        # Half the trace of D^-1 N and the root of the discriminant.
        middle = 0.5 * (N[0] * D[1] + N[1] * D[0] - 2 * (N[2] * D[2] + N[3] * D[3])) / d
        determinant = (N[0] * N[1] - N[2] * N[2] - N[3] * N[3]) / d
        value = middle + np.sqrt(max(middle * middle - determinant, 0.0))
        # a is orthogonal to the greater row of N - lambda D.
        x, z = N[0] - value * D[0], N[1] - value * D[1]
        y = complex(N[2] - value * D[2], N[3] - value * D[3])
        if abs(x) >= abs(z):
            a[0], a[1] = y, -x
        else:
            a[0], a[1] = z, -np.conj(y)
        return value
    vectors, lower, products = np.empty((2, m), np.complex128), np.empty((m, m), np.complex128), np.empty(m * m)
    last = value = 0.0
    for _ in range(steps):
        multiply(N, a, vectors[0])
        solve(D, vectors[0], vectors[1], lower)
        _normalise(vectors[1], a)
        fill_products(a, products)
        value = power_of(N, products) / max(power_of(D, products), TINY)
        if value - last <= _CONVERGED * value:
            break
        last = value
    return value


@kernel(types.void(REAL, types.int64, types.int64))
def _share(weight, first, last):  # type: ignore[no-untyped-def]  # numba
    """Scale weight[first:last] to a sum of 1; none falls so low that it could not grow again."""
    total = TINY
    for i in range(first, last):
        total += weight[i]
    for i in range(first, last):
        weight[i] = max(weight[i] / total, _LEAST_WEIGHT)


@kernel(types.void(ROWS, types.int64, types.int64, DRIVE, REAL, types.int64, _MIXED, _SPACE))
def weigh(forms, felt, quiet, a, weight, steps, mixed, space):  # type: ignore[no-untyped-def]  # numba
    """Steps of Lawson's weights and of the drive `a`, both in place: one step of the power iteration for each.

    weight (felt + quiet,): each side adds up to 1. mixed (3, part), space (actuator + 2, actuator): space for forms and
    vectors.
    """
    m, last = len(a), felt + quiet
    for _ in range(steps):
        mixed[0:2] = 0.0
        for i in range(last):
            side, scale = 0 if i < felt else 1, weight[i]
            for part in range(m * m):
                mixed[side, part] += scale * forms[i, part]
        multiply(mixed[0], a, space[0])
        solve(mixed[1], space[0], space[1], space[2:])
        _normalise(space[1], a)
        fill_products(a, mixed[2])
        for i in range(last):
            power = max(power_of(forms[i], mixed[2]), TINY)
            weight[i] = weight[i] / power if i < felt else weight[i] * power
        _share(weight, 0, felt)
        _share(weight, felt, last)


@kernel(types.float64(_RESPONSES, DRIVE))
def _loudness_under(p, a):  # type: ignore[no-untyped-def]  # numba
    """Power under the weakest finger of p (finger, actuator), the strongest actuator at 1."""
    least, greatest = np.inf, TINY
    for i in range(len(a)):
        greatest = max(greatest, a[i].real * a[i].real + a[i].imag * a[i].imag)
    for f in range(len(p)):
        response = 0j
        for i in range(len(a)):
            response += p[f, i] * a[i]
        least = min(least, response.real * response.real + response.imag * response.imag)
    return least / greatest


@kernel(types.float64(_RESPONSES, USABLE, DRIVE))
def find_loudest(p, usable, a):  # type: ignore[no-untyped-def]  # numba
    """Fill `a` with the drive of full amplitudes that is loudest under the weakest felt finger; its loudness.

    One felt finger: every actuator in phase there, which is the optimum. Several: steps that raise the sum of weighted
    powers at unit amplitudes, with Lawson's weights, started in phase under each finger in turn.
    """
    fingers, m = p.shape
    best = -1.0
    trial, moved, weight = np.empty(m, np.complex128), np.empty(m, np.complex128), np.empty(fingers)
    for start in range(fingers):
        for i in range(m):
            trial[i] = np.conj(p[start, i])
        weight[:] = 1.0 / fingers
        for _ in range(1 if fingers == 1 else _LOUD_STEPS):
            for i in range(m):
                size = abs(trial[i])
                trial[i] = trial[i] / size if usable[i] and size > 0 else 0j
            value = _loudness_under(p, trial)
            if value > best:
                best = value
                copy_drive(trial, a)
            if fingers == 1:
                break
            total = 0.0
            moved[:] = 0j
            for f in range(fingers):
                response = 0j
                for i in range(m):
                    response += p[f, i] * trial[i]
                weight[f] /= max(response.real**2 + response.imag**2, TINY)
                total += weight[f]
                for i in range(m):
                    moved[i] += weight[f] * np.conj(p[f, i]) * response
            weight /= total
            copy_drive(moved, trial)
    return best


@kernel(types.float64(ROWS, types.int64, types.int64, _RESPONSES, USABLE, types.float64, DRIVE))
def keep_level(forms, felt, quiet, p, usable, wanted, a):  # type: ignore[no-untyped-def]  # numba
    """Move `a` towards the loudest drive until it is loud enough; its ratio, or -1 where no drive is."""
    m = len(a)
    loud, trial, products = np.empty(m, np.complex128), np.empty(m, np.complex128), np.empty(m * m)
    if find_loudest(p, usable, loud) < wanted:
        return -1.0
    # Bring both to the same phase under the first felt finger and to the same strongest amplitude.
    own, other, strongest = 0j, 0j, TINY
    for i in range(m):
        own += p[0, i] * a[i]
        other += p[0, i] * loud[i]
        strongest = max(strongest, abs(a[i]))
    turn = own * np.conj(other)
    turn = turn / abs(turn) if abs(turn) > 0 else 1.0 + 0j
    low, high = 0.0, 1.0
    for step in range(_LINE_STEPS + 1):
        middle = 0.5 * (low + high) if step < _LINE_STEPS else high
        for i in range(m):
            trial[i] = (1 - middle) * a[i] / strongest + middle * turn * loud[i]
        fill_products(trial, products)
        if loudness_of(forms, felt + quiet, m, products) >= wanted:
            high = middle
        else:
            low = middle
    copy_drive(trial, a)
    return ratio_of(forms, felt, quiet, products)
