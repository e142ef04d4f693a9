"""Kernel: ascent of the greatest ratio of powers above a level at one frequency, by BFGS.

A drive a (actuator,) has felt powers N_i, quiet ones D_j and levels P_f, all a^H H a (engine.steady.forms):

    maximise  min_i N_i / max_j D_j   subject to   min_f P_f >= wanted max_l |a_l|^2 .

All of it is homogeneous of degree 0 in a, so the length of a is free. Logarithms turn the ratio into a difference.
Minima and maxima are replaced by their log-sum-exp of sharpness `beta`, which makes the objective differentiable, so
that quasi-Newton steps work; `beta` rises from climb to climb. The level is an exact penalty: missing it costs more
than any ratio can gain.
"""

import numpy as np
from numba import types

from engine.steady.forms import DRIVE, REAL, ROWS, TINY, USABLE, fill_products, kernel, multiply, power_of

PENALTY = 60.0  # nepers of ratio that a neper of missing level costs; what a level can be worth stays below
SHARPEST = 3000.0  # 1 / 3000 neper: the smoothed minimum of two is within 0.001 dB
_ITERATIONS, _GRADIENT, _ARMIJO, _GAIN = 40, 1e-7, 1e-4, 1e-6  # 20 lose nothing, a gain of 1e-4 0.2 dB (the search)
_SHARPER = 10**0.5  # half a decade a climb; a decade loses 0.02 dB at most (drive_search.py)
_SPACE = types.Array(types.float64, 2, "C")


@kernel(types.float64(REAL, types.int64, types.int64, types.float64, REAL))
def _soft(logs, first, last, beta, weight):  # type: ignore[no-untyped-def]  # numba
    """Smoothed maximum of logs[first:last], a negative `beta` for the minimum, and their weights."""
    sign = 1.0 if beta > 0.0 else -1.0
    top = -np.inf
    for i in range(first, last):
        top = max(top, sign * logs[i])
    total = 0.0
    for i in range(first, last):
        # Beyond 40 the exponential has no digit left to give.
        x = abs(beta) * (sign * logs[i] - top)
        weight[i] = np.exp(x) if x > -40.0 else 0.0
        total += weight[i]
    for i in range(first, last):
        weight[i] /= total
    return sign * top + np.log(total) / beta


@kernel(types.float64(DRIVE, USABLE, ROWS, types.int64, types.int64, types.float64, types.float64, DRIVE, _SPACE))
def evaluate(a, usable, forms, felt, quiet, log_wanted, beta, gradient, work):  # type: ignore[no-untyped-def]  # numba
    """Smoothed log ratio less the penalty, and its gradient over real and imaginary parts of a.

    forms (form, part): `felt` numerators, `quiet` denominators, levels. work (4, form + actuator**2): space.
    """
    m, count = len(a), len(forms)
    products, mixed, logs, weight = work[0], work[1], work[2], work[3]
    fill_products(a, products[: m * m])
    # Logarithms of all powers, those of the amplitudes last.
    for i in range(count):
        logs[i] = np.log(max(power_of(forms[i], products[: m * m]), TINY))
    for i in range(m):
        logs[count + i] = np.log(max(products[i], TINY))
    value = _soft(logs, 0, felt, -beta, weight) - _soft(logs, felt, felt + quiet, beta, weight)
    for i in range(felt, felt + quiet):
        weight[i] = -weight[i]
    mixed[: m * m] = 0.0
    last = felt + quiet
    if count > last:
        # Nepers by which the level is passed at full scale of the strongest actuator.
        spare = _soft(logs, last, count, -beta, weight) - _soft(logs, count, count + m, beta, weight) - log_wanted
        # Softplus of what is missing, computed without overflow, and its slope.
        x = -beta * spare
        missing = (x + np.log1p(np.exp(-x)) if x > 0 else np.log1p(np.exp(x))) / beta
        slope = PENALTY / (1.0 + np.exp(min(-x, 500.0)))
        value -= PENALTY * missing
        for i in range(last, count):
            weight[i] *= slope
        for i in range(m):
            mixed[i] = -slope * weight[count + i] * np.exp(-logs[count + i])
    # The gradient of log a^H H a is 2 H a over the power; all forms are added first.
    for i in range(count):
        if weight[i] != 0.0:
            scale = weight[i] * np.exp(-logs[i])
            for part in range(m * m):
                mixed[part] += scale * forms[i, part]
    multiply(mixed[: m * m], a, gradient)
    for i in range(m):
        gradient[i] = 2.0 * gradient[i] if usable[i] else 0j  # out of its band: it stays at zero
    return value


@kernel(types.void(REAL, _SPACE))
def _begin(g, inverse):  # type: ignore[no-untyped-def]  # numba
    """Begin the inverse Hessian, of which nothing is known: a short step along the gradient."""
    square = 0.0
    for i in range(len(g)):
        square += g[i] * g[i]
    for i in range(len(g)):
        for j in range(len(g)):
            inverse[i, j] = 0.1 / max(1.0, np.sqrt(square)) if i == j else 0.0


@kernel(types.void(REAL, REAL, types.float64, REAL, _SPACE))
def _update(s, y, curvature, moved, inverse):  # type: ignore[no-untyped-def]  # numba
    """Update the inverse Hessian by a step s and the change y of the gradient (BFGS); moved: space."""
    total = 0.0
    for i in range(len(s)):
        moved[i] = 0.0
        for j in range(len(s)):
            moved[i] += inverse[i, j] * y[j]
        total += moved[i] * y[i]
    factor = (1.0 + total / curvature) / curvature
    for i in range(len(s)):
        for j in range(len(s)):
            inverse[i, j] += factor * s[i] * s[j] - (moved[i] * s[j] + s[i] * moved[j]) / curvature


@kernel(types.void(DRIVE, USABLE, ROWS, types.int64, types.int64, types.float64, types.float64, types.float64))
def climb(a, usable, forms, felt, quiet, log_wanted, start, stop):  # type: ignore[no-untyped-def]  # numba
    """Quasi-Newton (BFGS) ascent of `a` in place, from sharpness `start` to `stop`."""
    m = len(a)
    size = 2 * m
    # Vectors of real and imaginary parts (2 actuator,) are views of complex ones.
    vectors = np.empty((5, m), dtype=np.complex128)
    gradient, trial_gradient, step, change, trial = vectors[0], vectors[1], vectors[2], vectors[3], vectors[4]
    g, new_g, s, y = (
        gradient.view(np.float64),
        trial_gradient.view(np.float64),
        step.view(np.float64),
        change.view(np.float64),
    )
    moved, inverse = np.empty(size), np.empty((size, size))
    work = np.empty((4, len(forms) + m * m))
    beta, value = start, 0.0
    while True:
        beta = stop if beta >= 0.99 * stop else beta
        length = 0.0
        for i in range(m):
            length += a[i].real * a[i].real + a[i].imag * a[i].imag
        for i in range(m):
            a[i] /= np.sqrt(length)
        value = evaluate(a, usable, forms, felt, quiet, log_wanted, beta, gradient, work)
        _begin(g, inverse)
        for _ in range(_ITERATIONS):
            slope, square = 0.0, 0.0
            for i in range(size):
                s[i] = 0.0
                for j in range(size):
                    s[i] += inverse[i, j] * g[j]
                slope += s[i] * g[i]
                square += s[i] * s[i]
            if slope <= _GRADIENT**2:
                break
            # Backtracking line search from at most 0.3 of the drive's length, until Armijo's condition holds.
            length, new, found = min(1.0, 0.3 / np.sqrt(square)), value, False
            for _ in range(30):
                for i in range(m):
                    trial[i] = a[i] + length * step[i]
                new = evaluate(trial, usable, forms, felt, quiet, log_wanted, beta, trial_gradient, work)
                if new >= value + _ARMIJO * length * slope:
                    found = True
                    break
                length *= 0.4
            if not found:
                break
            curvature, gain = 0.0, new - value
            for i in range(size):
                s[i] *= length
                y[i] = g[i] - new_g[i]
                curvature += s[i] * y[i]
                g[i] = new_g[i]
            for i in range(m):
                a[i] = trial[i]
            value = new
            if curvature > 1e-14:  # a step of no or negative curvature says nothing
                _update(s, y, curvature, moved, inverse)
            if gain < _GAIN:
                break
        if beta >= stop:
            return
        beta *= _SHARPER
