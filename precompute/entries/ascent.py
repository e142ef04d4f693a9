"""Kernel: ascent of the greatest ratio of Hermitian forms above a level, by BFGS.

A drive a (actuator,) has numerators N_i, denominators D_j and levels P_f, all a^H H a at its frequencies:

    maximise  min_i N_i / max_j D_j   subject to   min_f P_f >= wanted max_l |a_l|^2 .

All of it is homogeneous of degree 0 in a, so the length of a is free. Logarithms turn the ratio into a difference.
Minima and maxima are replaced by their log-sum-exp of sharpness `beta`, which makes the objective differentiable, so
that quasi-Newton steps work; `beta` rises from climb to climb. The level is an exact penalty: missing it costs more
than any ratio can gain.
"""

import numpy as np

from engine.compiled import njit

PENALTY, STIFF_PENALTY = 60.0, 1000.0
"""Nepers of ratio that a neper of missing level costs. Next to the loudest drive a level can be worth more than the
first; the second is for a climb from near by, since a stiff one ends early on its way."""
SHARPEST = 3000.0
"""1 / 3000 neper: the smoothed minimum of two is within 0.001 dB."""
_ITERATIONS, _GRADIENT, _ARMIJO, _GAIN = 60, 1e-7, 1e-4, 1e-7
_TINY = 1e-300
_SHARPER = 10**0.5


@njit(cache=True)
def _add_form(form, drive, scale, gradient):  # type: ignore[no-untyped-def]  # numba
    """Add scale times the gradient of a^H H a over real and imaginary parts: 2 H a."""
    for a in range(len(drive)):
        s = 0j
        for r in range(len(drive)):
            s += form[a, r] * drive[r]
        gradient[2 * a] += 2.0 * scale * s.real
        gradient[2 * a + 1] += 2.0 * scale * s.imag


@njit(cache=True)
def _power(form, drive):  # type: ignore[no-untyped-def]  # numba
    s = 0.0
    for a in range(len(drive)):
        t = 0j
        for r in range(len(drive)):
            t += form[a, r] * drive[r]
        s += (np.conj(drive[a]) * t).real
    return max(s, _TINY)


@njit(cache=True)
def _soft(logs, beta, sign, weights):  # type: ignore[no-untyped-def]  # numba
    """Smoothed maximum (sign 1) or minimum (-1) of `logs`, and its weights."""
    top = -np.inf
    for i in range(len(logs)):
        top = max(top, sign * logs[i])
    total = 0.0
    for i in range(len(logs)):
        weights[i] = np.exp(beta * (sign * logs[i] - top))
        total += weights[i]
    for i in range(len(logs)):
        weights[i] /= total
    return sign * (top + np.log(total) / beta)


@njit(cache=True)
def evaluate(  # type: ignore[no-untyped-def]  # numba
    drive, usable, numerator, denominator, level, log_wanted, beta, gradient, multipliers, logs, penalty
):
    """Smoothed log ratio less the penalty, its gradient (2 actuator,), and what each form weighs in it.

    multipliers: of log N_i, log D_j, log P_f and log |a_l|^2 one after another, all positive.
    """
    n, d, p, m = len(numerator), len(denominator), len(level), len(drive)
    # Logarithms of all powers, one after another as the multipliers are.
    logs_n, logs_d, logs_p, logs_a = logs[:n], logs[n : n + d], logs[n + d : n + d + p], logs[n + d + p :]
    for i in range(n):
        logs_n[i] = np.log(_power(numerator[i], drive))
    for i in range(d):
        logs_d[i] = np.log(_power(denominator[i], drive))
    for i in range(p):
        logs_p[i] = np.log(_power(level[i], drive))
    for a in range(m):
        logs_a[a] = np.log(max(abs(drive[a]) ** 2, _TINY))
    # Smoothed log of min N / max D; the multipliers become the weights of the smoothed minimum and maximum.
    value = _soft(logs_n, beta, -1.0, multipliers[:n]) - _soft(logs_d, beta, 1.0, multipliers[n : n + d])
    # Nepers by which the level is passed at full scale of the strongest actuator.
    spare = -_soft(logs_a, beta, 1.0, multipliers[n + d + p :]) - log_wanted
    if p == 0:
        spare = np.inf
    else:
        spare += _soft(logs_p, beta, -1.0, multipliers[n + d : n + d + p])
    # Softplus of what is missing, computed without overflow, and its slope.
    x = -beta * spare
    missing = (x + np.log1p(np.exp(-x)) if x > 0 else np.log1p(np.exp(x))) / beta
    slope = penalty / (1.0 + np.exp(min(-x, 500.0)))
    value -= penalty * missing
    for i in range(n + d, len(multipliers)):
        multipliers[i] *= slope
    # The gradient of log a^H H a is 2 H a over the power.
    for i in range(2 * m):
        gradient[i] = 0.0
    for i in range(n):
        _add_form(numerator[i], drive, multipliers[i] * np.exp(-logs_n[i]), gradient)
    for i in range(d):
        _add_form(denominator[i], drive, -multipliers[n + i] * np.exp(-logs_d[i]), gradient)
    for i in range(p):
        _add_form(level[i], drive, multipliers[n + d + i] * np.exp(-logs_p[i]), gradient)
    for a in range(m):
        scale = -2.0 * multipliers[n + d + p + a] * np.exp(-logs_a[a])
        gradient[2 * a] += scale * drive[a].real
        gradient[2 * a + 1] += scale * drive[a].imag
        if not usable[a]:  # out of its band: it stays as it is, at zero
            gradient[2 * a], gradient[2 * a + 1] = 0.0, 0.0
    return value


@njit(cache=True)
def _multiply(matrix, vector, out):  # type: ignore[no-untyped-def]  # numba
    """Fill `out` with the product; numba's own matrix product would need SciPy, which the live loop does not import."""
    for r in range(len(out)):
        out[r] = 0.0
        for c in range(len(vector)):
            out[r] += matrix[r, c] * vector[c]


@njit(cache=True)
def _dot(first, second):  # type: ignore[no-untyped-def]  # numba
    """Sum of the products, in a loop: array expressions and assignments of slices take seconds to compile."""
    total = 0.0
    for i in range(len(first)):
        total += first[i] * second[i]
    return total


@njit(cache=True)
def _climb_at(  # type: ignore[no-untyped-def]  # numba
    drive, usable, numerator, denominator, level, log_wanted, beta, multipliers, penalty
):
    """Quasi-Newton (BFGS) ascent of `drive` in place at one sharpness; the value reached."""
    m = len(drive)
    size = 2 * m
    power = 0.0
    for a in range(m):
        power += abs(drive[a]) ** 2
    scale = 1.0 / np.sqrt(power)
    for a in range(m):
        drive[a] = complex(drive[a].real * scale, drive[a].imag * scale)
    gradient, trial_gradient, step, change = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    moved, inverse = np.empty(size), np.empty((size, size))
    trial, logs = np.empty_like(drive), np.empty(len(multipliers))
    goal = numerator, denominator, level, log_wanted, beta
    value = evaluate(drive, usable, *goal, gradient, multipliers, logs, penalty)
    # Of the inverse Hessian nothing is known at first: a short step along the gradient.
    first = 1.0 / max(1.0, np.sqrt(_dot(gradient, gradient))) * 0.1
    for r in range(size):
        for c in range(size):
            inverse[r, c] = first if r == c else 0.0
    for _ in range(_ITERATIONS):
        _multiply(inverse, gradient, step)
        slope = _dot(step, gradient)
        if slope <= _GRADIENT**2:
            break
        # Backtracking line search from at most 0.3 of the drive's length, until Armijo's condition holds.
        length = min(1.0, 0.3 / np.sqrt(_dot(step, step)))
        found = False
        for _ in range(30):
            for a in range(m):
                trial[a] = drive[a] + length * complex(step[2 * a], step[2 * a + 1])
            new = evaluate(trial, usable, *goal, trial_gradient, multipliers, logs, penalty)
            if new >= value + _ARMIJO * length * slope:
                found = True
                break
            length *= 0.4
        if not found:
            break
        for r in range(size):
            step[r] *= length
            change[r] = gradient[r] - trial_gradient[r]
            gradient[r] = trial_gradient[r]
        for a in range(m):
            drive[a] = trial[a]
        curvature, gain, value = _dot(step, change), new - value, new
        # BFGS update of the inverse Hessian; a step of no or negative curvature leaves it.
        if curvature > 1e-14:
            _multiply(inverse, change, moved)
            factor = (1.0 + _dot(change, moved) / curvature) / curvature
            for r in range(size):
                for c in range(size):
                    inverse[r, c] += factor * step[r] * step[c] - (moved[r] * step[c] + step[r] * moved[c]) / curvature
        if gain < _GAIN:
            break
    return evaluate(drive, usable, *goal, gradient, multipliers, logs, penalty)


@njit(cache=True)
def climb(  # type: ignore[no-untyped-def]  # numba
    drive, usable, numerator, denominator, level, log_wanted, start, stop, multipliers, penalty
):
    """Ascent of `drive` in place from sharpness `start` to `stop`; the value reached, in nepers of power."""
    forms = numerator, denominator, level
    beta = start
    while beta < 0.99 * stop:
        _climb_at(drive, usable, *forms, log_wanted, beta, multipliers, penalty)
        beta *= _SHARPER
    return _climb_at(drive, usable, *forms, log_wanted, stop, multipliers, penalty)
