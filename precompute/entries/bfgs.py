"""Kernels of the search: ascent of the greatest ratio of Hermitian forms above a level, by BFGS.

A drive a (actuator,) has numerators N_i, denominators D_j and levels P_f, all a^H H a at its frequencies:

    maximise  min_i N_i / max_j D_j   subject to   min_f P_f >= wanted max_l |a_l|^2 .

All of it is homogeneous of degree 0 in a, so the length of a is free. Logarithms turn the ratio into a difference.
Minima and maxima are replaced by their log-sum-exp of sharpness `beta`, which makes the objective differentiable, so
that quasi-Newton steps work; `beta` rises from climb to climb. The level is an exact penalty: missing it costs more
than any ratio can gain.
"""

import numpy as np
from numba import njit, prange, types

PENALTY = 60.0
"""Nepers of ratio that a neper of missing level costs; what a level can be worth stays below."""
SHARPEST = 3000.0
"""1 / 3000 neper: the smoothed minimum of two is within 0.001 dB."""
_ITERATIONS, _GRADIENT, _ARMIJO, _GAIN = 60, 1e-7, 1e-4, 1e-7
_TINY = 1e-300
_SWEEPS = 3  # over the frequencies of several tones, since they depend on one another
_FIRST = 30.0
_ALONG = SHARPEST / 10  # first sharpness of a climb that starts next to a climbed drive
_SHARPER = 10**0.5
_GOLDEN = 0.6180339887498949

_STACK = types.Array(types.complex128, 4, "C", readonly=True)
_FORMS = types.Array(types.complex128, 3, "C", readonly=True)
_REAL = types.Array(types.float64, 1, "C", readonly=True)
_HZ = types.Array(types.float64, 1, "C")
_TONE = types.Array(types.int64, 1, "C", readonly=True)
_DRIVES = types.Array(types.complex128, 2, "C")
_USABLES = types.Array(types.boolean, 2, "C", readonly=True)
_TONES = types.Array(types.int64, 2, "C", readonly=True)
_BOUNDS = types.Array(types.float64, 2, "C", readonly=True)
_HZS = types.Array(types.float64, 2, "C")


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
    drive, usable, numerator, denominator, level, log_wanted, beta, gradient, multipliers, logs
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
    slope = PENALTY / (1.0 + np.exp(min(-x, 500.0)))
    value -= PENALTY * missing
    multipliers[n + d :] *= slope
    # The gradient of log a^H H a is 2 H a over the power.
    gradient[:] = 0.0
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
def _climb_at(  # type: ignore[no-untyped-def]  # numba
    drive, usable, numerator, denominator, level, log_wanted, beta, multipliers
):
    """Quasi-Newton (BFGS) ascent of `drive` in place at one sharpness; the value reached."""
    m = len(drive)
    size = 2 * m
    drive /= np.sqrt(np.sum(np.abs(drive) ** 2))
    gradient, trial_gradient, step, change = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    trial, logs = np.empty_like(drive), np.empty(len(multipliers))
    value = evaluate(drive, usable, numerator, denominator, level, log_wanted, beta, gradient, multipliers, logs)
    # Of the inverse Hessian nothing is known at first: a short step along the gradient.
    inverse = np.eye(size) / max(1.0, np.sqrt(np.sum(gradient**2))) * 0.1
    for _ in range(_ITERATIONS):
        step[:] = inverse @ gradient
        slope = np.sum(step * gradient)
        if slope <= _GRADIENT**2:
            break
        # Backtracking line search from at most 0.3 of the drive's length, until Armijo's condition holds.
        length = min(1.0, 0.3 / np.sqrt(np.sum(step**2)))
        found = False
        for _ in range(30):
            for a in range(m):
                trial[a] = drive[a] + length * complex(step[2 * a], step[2 * a + 1])
            new = evaluate(
                trial, usable, numerator, denominator, level, log_wanted, beta, trial_gradient, multipliers, logs
            )
            if new >= value + _ARMIJO * length * slope:
                found = True
                break
            length *= 0.4
        if not found:
            break
        step *= length
        change[:] = gradient - trial_gradient
        curvature = np.sum(step * change)
        gain = new - value
        drive[:], gradient[:], value = trial, trial_gradient, new
        # BFGS update of the inverse Hessian; a step of no or negative curvature leaves it.
        if curvature > 1e-14:
            moved = inverse @ change
            factor = (1.0 + np.sum(change * moved) / curvature) / curvature
            for r in range(size):
                for c in range(size):
                    inverse[r, c] += factor * step[r] * step[c] - (moved[r] * step[c] + step[r] * moved[c]) / curvature
        if gain < _GAIN:
            break
    return evaluate(drive, usable, numerator, denominator, level, log_wanted, beta, gradient, multipliers, logs)


@njit(cache=True)
def climb(drive, usable, numerator, denominator, level, log_wanted, start, stop, multipliers):  # type: ignore[no-untyped-def]  # numba
    """Ascent of `drive` in place from sharpness `start` to `stop`; the value reached, in nepers of power."""
    beta = start
    while beta < 0.99 * stop:
        _climb_at(drive, usable, numerator, denominator, level, log_wanted, beta, multipliers)
        beta *= _SHARPER
    return _climb_at(drive, usable, numerator, denominator, level, log_wanted, stop, multipliers)


@njit(cache=True)
def interpolate(stack, grid_hz, frequency_hz, tone, out):  # type: ignore[no-untyped-def]  # numba
    """Forms (form, actuator, actuator) of a drive with tones at frequency_hz (tone,), tone (actuator,) each one's.

    Cubic through four neighbours of the grid; actuators on different tones do not interfere.
    """
    count, m = len(grid_hz), len(tone)
    out[:] = 0.0
    for t in range(len(frequency_hz)):
        f = frequency_hz[t]
        first = min(max(np.searchsorted(grid_hz, f) - 2, 0), max(count - 4, 0))
        last = min(first + 4, count)
        for k in range(first, last):
            weight = 1.0
            for other in range(first, last):
                if other != k:
                    weight *= (f - grid_hz[other]) / (grid_hz[k] - grid_hz[other])
            for i in range(stack.shape[0]):
                for a in range(m):
                    for r in range(m):
                        if tone[a] == t and tone[r] == t:
                            out[i, a, r] += weight * stack[i, k, a, r]


@njit(types.void(_STACK, _REAL, _REAL, _TONE, types.Array(types.complex128, 1, "C", readonly=True), _HZ), cache=True)
def fill_powers(stack, grid_hz, frequency_hz, tone, drive, out):  # type: ignore[no-untyped-def]  # numba
    """Fill out (form,) with a^H H a of a drive whose actuators play frequency_hz[tone]."""
    forms = np.empty((stack.shape[0], stack.shape[2], stack.shape[3]), dtype=np.complex128)
    interpolate(stack, grid_hz, frequency_hz, tone, forms)
    for i in range(len(out)):
        total = 0.0
        for a in range(len(drive)):
            for b in range(len(drive)):
                total += (np.conj(drive[a]) * forms[i, a, b] * drive[b]).real
        out[i] = total


@njit(cache=True)
def _at(drive, usable, stacks, grid_hz, hz, tone, log_wanted, start, multipliers):  # type: ignore[no-untyped-def]  # numba
    numerator, denominator, level = stacks
    m = len(tone)
    n = np.empty((numerator.shape[0], m, m), dtype=np.complex128)
    d = np.empty((denominator.shape[0], m, m), dtype=np.complex128)
    p = np.empty((level.shape[0], m, m), dtype=np.complex128)
    interpolate(numerator, grid_hz, hz, tone, n)
    interpolate(denominator, grid_hz, hz, tone, d)
    interpolate(level, grid_hz, hz, tone, p)
    return climb(drive, usable, n, d, p, log_wanted, start, SHARPEST, multipliers)


@njit(cache=True)
def _refine_one(  # type: ignore[no-untyped-def]  # numba
    drive, usable, numerator, denominator, level, grid_hz, hz, tone, low, high, log_wanted, tolerance, multipliers
):
    stacks = (numerator, denominator, level)
    first = _ALONG if np.isinf(tolerance) else _FIRST
    value = _at(drive, usable, stacks, grid_hz, hz, tone, log_wanted, first, multipliers)
    trial_hz = hz.copy()
    sweeps = 1 if len(hz) == 1 else _SWEEPS
    for i in range(sweeps * len(hz)):
        t = i % len(hz)
        a, b = low[t], high[t]
        if b - a <= tolerance:
            continue
        x, y = b - _GOLDEN * (b - a), a + _GOLDEN * (b - a)
        at_x, at_y = drive.copy(), drive.copy()
        # Golden section on the frequency of tone t, each end with a drive of its own that climbs along.
        trial_hz[:] = hz
        trial_hz[t] = x
        value_x = _at(at_x, usable, stacks, grid_hz, trial_hz, tone, log_wanted, _ALONG, multipliers)
        trial_hz[t] = y
        value_y = _at(at_y, usable, stacks, grid_hz, trial_hz, tone, log_wanted, _ALONG, multipliers)
        while b - a > tolerance:
            if value_x >= value_y:
                b, y, value_y = y, x, value_x
                at_y[:] = at_x
                x = b - _GOLDEN * (b - a)
                trial_hz[t] = x
                value_x = _at(at_x, usable, stacks, grid_hz, trial_hz, tone, log_wanted, _ALONG, multipliers)
            else:
                a, x, value_x = x, y, value_y
                at_x[:] = at_y
                y = a + _GOLDEN * (b - a)
                trial_hz[t] = y
                value_y = _at(at_y, usable, stacks, grid_hz, trial_hz, tone, log_wanted, _ALONG, multipliers)
        # The tone moves only if that was better.
        better = max(value_x, value_y)
        if better > value:
            value = better
            hz[t] = x if value_x >= value_y else y
            drive[:] = at_x if value_x >= value_y else at_y
    return _at(drive, usable, stacks, grid_hz, hz, tone, log_wanted, SHARPEST, multipliers)


@njit(
    types.void(
        _DRIVES,
        _USABLES,
        _STACK,
        _STACK,
        _STACK,
        _REAL,
        _HZS,
        _TONES,
        _BOUNDS,
        _BOUNDS,
        types.float64,
        types.float64,
        _HZS,
    ),
    cache=True,
    parallel=True,
)
def refine(  # type: ignore[no-untyped-def]  # numba
    drives, usable, numerator, denominator, level, grid_hz, hz, tone, low, high, log_wanted, tolerance, multipliers
):
    """Climb from each of `drives` (start, actuator), moving its tones hz (start, tone) between low and high; in place.

    usable, tone (start, actuator). Golden section on each frequency in turn, the drive climbing along; frequencies end
    within `tolerance`; an infinite one keeps them and climbs only the last steps. multipliers (start, form): as
    `evaluate` leaves them at the end.
    """
    for i in prange(len(drives)):
        _refine_one(
            drives[i],
            usable[i],
            numerator,
            denominator,
            level,
            grid_hz,
            hz[i],
            tone[i],
            low[i],
            high[i],
            log_wanted,
            tolerance,
            multipliers[i],
        )


@njit(
    types.void(_DRIVES, _USABLES, _STACK, _STACK, _STACK, types.float64, types.float64, types.float64, _HZ),
    cache=True,
    parallel=True,
)
def climb_each(drives, usable, numerator, denominator, level, log_wanted, start, stop, value):  # type: ignore[no-untyped-def]  # numba
    """Climb one drive (frequency, actuator) at each frequency of the stacks; in place, value (frequency,)."""
    for f in prange(len(drives)):
        multipliers = np.empty(numerator.shape[0] + denominator.shape[0] + level.shape[0] + drives.shape[1])
        value[f] = climb(
            drives[f],
            usable[f],
            numerator[:, f].copy(),
            denominator[:, f].copy(),
            level[:, f].copy(),
            log_wanted,
            start,
            stop,
            multipliers,
        )


@njit(types.void(_FORMS, _FORMS, _HZ), cache=True)
def greatest_eigenvalue(numerator, denominator, out):  # type: ignore[no-untyped-def]  # numba
    """Fill out (frequency,) with the greatest lambda of N a = lambda D a; forms (frequency, actuator, actuator)."""
    m = numerator.shape[1]
    for f in range(numerator.shape[0]):
        if m == 1:
            out[f] = (numerator[f, 0, 0] / denominator[f, 0, 0]).real
        elif m == 2:  # closed form: half the trace plus the root of the discriminant of D^-1 N
            n, d = numerator[f], denominator[f]
            det_n = (n[0, 0] * n[1, 1] - n[0, 1] * n[1, 0]).real
            det_d = (d[0, 0] * d[1, 1] - d[0, 1] * d[1, 0]).real
            middle = 0.5 * (n[0, 0] * d[1, 1] + n[1, 1] * d[0, 0] - n[0, 1] * d[1, 0] - n[1, 0] * d[0, 1]).real / det_d
            out[f] = middle + np.sqrt(max(middle * middle - det_n / det_d, 0.0))
        else:  # turned into an ordinary eigenproblem by the Cholesky factor of D
            lower = np.linalg.inv(np.linalg.cholesky(denominator[f]))
            out[f] = np.linalg.eigvalsh(lower @ numerator[f] @ lower.conj().T)[-1]
