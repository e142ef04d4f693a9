"""Kernel: about the best drive at one frequency where its level needs full scale, by the dual of a convex problem.

A drive a (actuator,) has amplitudes of at most 1, felt fingers with responses p_f, and quiet powers D_j. With the phase
u_f of what each felt finger feels held, the least strongest quiet power is a convex problem:

    minimise  max_j a^H D_j a   subject to   Re(u_f* p_f a) >= sqrt(wanted),   |a_i| <= 1 .

Multipliers d_j of the quiet powers (they add up to 1), mu_f of the levels and nu_i of the amplitudes give a drive,

    a = (sum_j d_j D_j + diag nu)^-1 (q + sum_f mu_f u_f p_f^*),   q = 0 ,

and a bound: no drive of these phases has less than a^H (sum_j d_j D_j) a + sum_i nu_i (|a_i|^2 - 1). One nu_i at a
time is brought to where its amplitude is 1; the inverse follows by a rank-one update (Sherman and Morrison), and with
one felt finger the step is exact. Then the phases follow the drive, and the weights d_j as Lawson's do
(engine.steady.optimum).

With one numerator N, the felt power over sampled fingers or an energy, its slope at the last drive joins,
q = D(a) / N(a) N a, by which the ratio itself rises from round to round (Dinkelbach 1967). One felt finger has one
phase, which is free, so that what is found is the best drive; several have phases to each other, and two starts.
"""

import numpy as np
from numba import types

from engine.steady.forms import (
    DRIVE,
    REAL,
    ROWS,
    TINY,
    USABLE,
    copy_drive,
    fill_products,
    invert,
    kernel,
    loudness_of,
    multiply,
    power_of,
    ratio_of,
)
from engine.steady.optimum import keep_level

_CLOSE = 5e-5  # tolerance of an amplitude at full scale, relative
_ALMOST = 0.98  # a drive is taken with this part of the wanted power; the loudest drive adds the rest
_STEPS = 24  # for each actuator; 8 leave a deep minimum that is 11 dB from its depth
_ROUNDS, _FEW_ROUNDS = 3, 2  # two for all leave 98.3 of 99.0 % of 525 placements within 0.1 dB of a patient search
_MOST = 1e9  # greatest change of a multiplier in one step, relative to 1 / inverse[i, i], so that rounding stays finite
_LEAST_ROOM = 1e-12  # below this relative slope levels alone determine an amplitude, whatever its multiplier is
_LEAST_WEIGHT = 1e-4  # as in optimum.py

_COUNT = types.int64
_MATRIX = types.Array(types.complex128, 2, "C")
_REALS = types.Array(types.float64, 2, "C")
_FLAGS = types.Array(types.boolean, 1, "C")


@kernel(types.void(_REALS, REAL, _FLAGS, REAL))
def _substitute(lower, right, is_active, out):  # type: ignore[no-untyped-def]  # numba
    """Fill out (finger,) with the solution of lower lower^T x = right, where inactive parts of `right` are 0."""
    count = len(out)
    for i in range(count):
        s = right[i] if is_active[i] else 0.0
        for k in range(i):
            s -= lower[i, k] * out[k]
        out[i] = s / lower[i, i]
    for i in range(count - 1, -1, -1):
        s = out[i]
        for k in range(i + 1, count):
            s -= lower[k, i] * out[k]
        out[i] = s / lower[i, i]


@kernel(types.void(_REALS, REAL, _REALS, _FLAGS, REAL))
def _solve_levels(M, missing, lower, is_active, mu):  # type: ignore[no-untyped-def]  # numba
    """Fill mu (finger,) with the multipliers, none below 0, by which active levels get what is missing (finger,).

    lower: Cholesky's factor of the active part of M.
    """
    count = len(mu)
    is_active[:] = True
    while True:
        floor = 0.0
        for f in range(count):
            floor += 1e-12 * M[f, f]
        # Cholesky's factors of the active part; the other rows and columns are replaced by the identity's.
        for i in range(count):
            for j in range(i + 1):
                is_one = is_active[i] and is_active[j]
                s = M[i, j] if is_one else (1.0 if i == j else 0.0)
                for k in range(j):
                    s -= lower[i, k] * lower[j, k]
                lower[i, j] = np.sqrt(max(s, floor)) if i == j else s / lower[j, j]
        _substitute(lower, missing, is_active, mu)
        at = 0
        for f in range(count):
            if mu[f] < mu[at]:
                at = f
        if not mu[at] < 0.0:
            return
        is_active[at] = False


@kernel(types.void(_MATRIX, _MATRIX, DRIVE, types.float64, _MATRIX, _REALS, _FLAGS, REAL, DRIVE))
def _answer(inverse, turned, q, root, z, lower, is_active, mu, a):  # type: ignore[no-untyped-def]  # numba
    """Fill a, the drive of these multipliers of amplitudes, with z (finger, actuator) and mu (finger,) of its levels.

    turned (finger, actuator): u_f* p_f.
    """
    fingers, m = turned.shape
    missing, M = np.empty(fingers), np.empty((fingers, fingers))
    for i in range(m):
        s = 0j
        for j in range(m):
            s += inverse[i, j] * q[j]
        a[i] = s
        for f in range(fingers):
            s = 0j
            for j in range(m):
                s += inverse[i, j] * np.conj(turned[f, j])
            z[f, i] = s
    for f in range(fingers):
        missing[f] = root
        for i in range(m):
            missing[f] -= (turned[f, i] * a[i]).real
        for h in range(fingers):
            s = 0.0
            for i in range(m):
                s += (turned[f, i] * z[h, i]).real
            M[f, h] = s
    _solve_levels(M, missing, lower, is_active, mu)
    for f in range(fingers):
        for i in range(m):
            a[i] += mu[f] * z[f, i]


@kernel(types.float64(ROWS, types.int64, REAL, REAL, DRIVE, REAL))
def _dual(forms, felt, mixed, nu, a, products):  # type: ignore[no-untyped-def]  # numba
    """The least numerator of `a` over the value of the dual; fills products (part,)."""
    fill_products(a, products)
    above, below = np.inf, power_of(mixed, products)
    for i in range(len(nu)):
        below -= nu[i]
    for i in range(felt):
        above = min(above, power_of(forms[i], products))
    return above / below if below > 0.0 else np.inf


@kernel(types.boolean(_MATRIX, DRIVE, types.float64, REAL, REAL, _MATRIX, _MATRIX, _REALS, _FLAGS, REAL, DRIVE))
def _step(turned, q, root, mixed, nu, inverse, z, lower, is_active, mu, a):  # type: ignore[no-untyped-def]  # numba
    """Bring the amplitude with the greatest error to full scale by its multiplier, in place; False: none had one."""
    fingers, m = turned.shape
    worst, at, excess = _CLOSE, -1, 0.0
    for i in range(m):
        each = abs(a[i]) - 1.0
        if abs(each) > worst and (each > 0.0 or nu[i] > 0.0):
            worst, at, excess = abs(each), i, each
    if at < 0:
        return False
    # How far the amplitude follows its multiplier where the active levels are kept.
    y, x = np.empty(fingers), np.empty(fingers)
    for f in range(fingers):
        y[f] = (np.conj(z[f, at]) * a[at]).real
    _substitute(lower, y, is_active, x)
    alone, square = inverse[at, at].real, abs(a[at]) ** 2
    room = alone
    for f in range(fingers):
        if is_active[f]:
            room -= x[f] * y[f] / max(square, TINY)
    if room <= _LEAST_ROOM * alone:
        return False
    change = max(min(excess / room, _MOST / alone), -nu[at])
    nu[at] += change
    mixed[at] += change
    column = inverse[:, at].copy()
    factor = change / (1.0 + change * alone)
    for i in range(m):
        for j in range(m):
            inverse[i, j] -= factor * column[i] * np.conj(column[j])
    _answer(inverse, turned, q, root, z, lower, is_active, mu, a)
    return True


@kernel(types.float64(ROWS, _COUNT, _COUNT, _MATRIX, types.float64, types.float64, _COUNT, REAL, REAL, DRIVE))
def _approach(forms, felt, quiet, p, wanted, floor, rounds, weight, nu, a):  # type: ignore[no-untyped-def]  # numba
    """Bring `a` to the best drive of the phases that it has, in place, and these on; its ratio, by the dual.

    Where the multipliers that it is given leave no more than `floor`, that ratio at once.
    """
    fingers, m = p.shape
    turned, z = np.empty((fingers, m), np.complex128), np.empty((fingers, m), np.complex128)
    inverse, lower = np.empty((m, m), np.complex128), np.empty((fingers, fingers))
    is_active, mu = np.empty(fingers, dtype=np.bool_), np.empty(fingers)
    q, products, mixed = np.zeros(m, np.complex128), np.empty(m * m), np.empty(m * m)
    root, value = np.sqrt(wanted), 0.0
    for turn in range(rounds):
        least = np.inf
        for f in range(fingers):
            response = 0j
            for i in range(m):
                response += p[f, i] * a[i]
            size = abs(response)
            least = min(least, size)
            unit = np.conj(response) / size if size > 0.0 else 1.0 + 0j
            for i in range(m):
                turned[f, i] = unit * p[f, i]
        if turn == 0:  # to the level; amplitudes may be greater than 1
            for i in range(m):
                a[i] *= root / max(least, TINY)
        fill_products(a, products)
        mixed[:] = 0.0
        for j in range(quiet):
            for part in range(m * m):
                mixed[part] += weight[j] * forms[felt + j, part]
        if felt == 1:
            multiply(forms[0], a, q)
            scale = power_of(mixed, products) / max(power_of(forms[0], products), TINY)
            for i in range(m):
                q[i] *= scale
        for i in range(m):
            mixed[i] += nu[i]
        invert(mixed, inverse)
        _answer(inverse, turned, q, root, z, lower, is_active, mu, a)
        if turn == 0 and floor > 0.0:
            value = _dual(forms, felt, mixed, nu, a, products)
            if value <= floor:
                return value
        for _ in range(_STEPS * m):
            if not _step(turned, q, root, mixed, nu, inverse, z, lower, is_active, mu, a):
                break
        value = _dual(forms, felt, mixed, nu, a, products)
        total = TINY
        for j in range(quiet):
            weight[j] *= max(power_of(forms[felt + j], products), TINY)
            total += weight[j]
        for j in range(quiet):
            weight[j] = max(weight[j] / total, _LEAST_WEIGHT)
    return value


@kernel(types.float64(ROWS, _COUNT, _COUNT, _MATRIX, USABLE, types.float64, types.float64, DRIVE, REAL, REAL, DRIVE))
def keep_limits(forms, felt, quiet, p, usable, wanted, floor, loud, weight, nu, a):  # type: ignore[no-untyped-def]  # numba
    """Bring `a` to about the best drive that is loud enough, in place, where the `loud` one is; its ratio.

    forms (form, part): `felt` numerators, `quiet` denominators, levels. p (finger, actuator): responses that the levels
    are powers of. weight (quiet,), nu (actuator,): multipliers, in place, of a neighbour and for the next. No drive is
    searched where no more than the ratio `floor` is left, and that little returned; 0: everywhere.
    """
    m, last = len(a), felt + quiet
    products, best, left, trial = np.empty(m * m), -1.0, -1.0, a.copy()
    rounds = _FEW_ROUNDS if floor > 0.0 and last == 2 and len(p) == 1 else _ROUNDS
    for start in range(2 if len(p) > 1 else 1):
        if best >= 0.0:
            break
        if start == 1:
            # With the phases of the loudest drive the convex problem has a solution.
            copy_drive(loud, trial)
            nu[:] = 0.0
        value = _approach(forms, felt, quiet, p, wanted, floor, rounds, weight, nu, trial)
        if value <= floor:
            left = max(left, value)
            continue
        fill_products(trial, products)
        is_finite = np.isfinite(products.sum())
        if is_finite and loudness_of(forms, last, m, products) >= _ALMOST * wanted:
            best = ratio_of(forms, felt, quiet, products)
            copy_drive(trial, a)
        else:
            nu[:], weight[:] = 0.0, 1.0 / quiet
            if is_finite and start == 0:
                copy_drive(trial, a)
    best = max(best, left)
    return best if best >= 0.0 else keep_level(forms, felt, quiet, p, usable, wanted, a)
