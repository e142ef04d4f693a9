"""Kernel: the best drive of one tone over all frequencies, from loaded responses (engine.steady.loading).

Every frequency of the grid gets a drive and its ratio (engine.steady.optimum). The best peaks over frequency are then
refined with the frequency free, between the peak's neighbours; there the responses, not the powers, are interpolated,
since powers under a quiet finger have deep minima. With several fingers, or where the level binds beyond two
actuators, each step of the refinement ends with the ascent of engine.steady.ascent, which is exact at its frequency.
"""

import numpy as np
from numba import njit, types

from engine.steady.ascent import SHARPEST, climb
from engine.steady.optimum import (
    POWER_STEPS,
    approach_level,
    find_loudest,
    keep_level,
    loudness_of,
    ratio_of,
    solve_dominant,
    solve_on_limit,
    weigh,
)

_LEVEL_MARGIN = 1 + 1e-4
"""So that smoothing does not leave a level short: 0.0004 dB."""
_STEPS, _FIRST_STEPS = 2, 12
_NEAR, _NEAR_SEVERAL = 0.9, 0.5
"""Peaks whose ratio is above this fraction of the best one's are refined."""
_NEAR_FIRST = 0.25
"""Where the level binds, no drive is searched between two frequencies whose ratios are below this fraction."""
_PEAKS = 6
_CLOSE = 0.95
"""Of those, peaks whose drive at the grid's frequency is above this fraction of the best are refined further."""
_STRIDE = 4
_SCAN_STEPS = 4
_GOLDEN = 0.6180339887498949
_SECTIONS, _FEW_SECTIONS = 9, 5
_FIRST_SHARPNESS, _NEXT_SHARPNESS = 30.0, 1000.0


@njit(cache=True)
def _unpack(packed, k, m, out):  # type: ignore[no-untyped-def]  # numba
    """Fill out (form, actuator, actuator) with the forms packed (form, part, frequency) at frequency k."""
    for i in range(len(out)):
        part = m
        for a in range(m):
            out[i, a, a] = packed[i, a, k]
            for b in range(a + 1, m):
                out[i, a, b] = complex(packed[i, part, k], packed[i, part + 1, k])
                out[i, b, a] = np.conj(out[i, a, b])
                part += 2


@njit(cache=True)
def _mute(usable, N, D, p):  # type: ignore[no-untyped-def]  # numba
    """Take actuators out that may not play: no power, no response, and denominators that stay definite."""
    m = len(usable)
    for a in range(m):
        if usable[a]:
            continue
        for b in range(m):
            N[:, a, b], N[:, b, a], D[:, a, b], D[:, b, a] = 0j, 0j, 0j, 0j
        p[:, a] = 0j
    for j in range(len(D)):
        trace = 0.0
        for a in range(m):
            trace += D[j, a, a].real
        for a in range(m):
            if not usable[a]:
                D[j, a, a] = trace + 1e-300


@njit(cache=True)
def _neighbours(hz, grid_hz):  # type: ignore[no-untyped-def]  # numba
    """The first of four neighbours of a frequency in the grid, and their weights in the cubic through them."""
    count = len(grid_hz)
    first = max(min(np.searchsorted(grid_hz, hz) - 2, count - 4), 0)
    last = min(first + 4, count)
    weight = np.ones(last - first)
    for k in range(first, last):
        for other in range(first, last):
            if other != k:
                weight[k - first] *= (hz - grid_hz[other]) / (grid_hz[k] - grid_hz[other])
    return first, weight


@njit(cache=True)
def _fill_power(grid_hz, hz, loaded, a, power):  # type: ignore[no-untyped-def]  # numba
    """Fill power (case, finger) with the power of a drive under every finger."""
    first, weight = _neighbours(hz, grid_hz)
    for c in range(power.shape[0]):
        for f in range(power.shape[1]):
            y = 0j
            for i in range(len(a)):
                for k in range(len(weight)):
                    y += weight[k] * complex(loaded[c, f, i, 0, first + k], loaded[c, f, i, 1, first + k]) * a[i]
            power[c, f] = y.real * y.real + y.imag * y.imag


@njit(cache=True)
def _forms_at(hz, grid_hz, loaded, felt, quiet, numerator, denominator, is_share, N, D, p):  # type: ignore[no-untyped-def]  # numba
    """Fill N, D and p with the forms and felt responses at any frequency, cubic through four neighbours of the grid."""
    m = loaded.shape[2]
    first, weight = _neighbours(hz, grid_hz)
    last = first + len(weight)
    for f in range(len(felt)):
        for a in range(m):
            p[f, a] = 0j
            for k in range(first, last):
                p[f, a] += weight[k - first] * complex(loaded[0, felt[f], a, 0, k], loaded[0, felt[f], a, 1, k])
    N[:], D[:] = 0j, 0j
    if is_share:
        form = np.empty_like(N)
        for k in range(first, last):
            _unpack(numerator, k, m, form)
            N += weight[k - first] * form
            _unpack(denominator, k, m, form)
            D += weight[k - first] * form
        return
    y = np.empty(m, dtype=np.complex128)
    for side in range(2):
        fingers, out = (felt, N) if side == 0 else (quiet, D)
        for f in range(len(fingers)):
            for c in range(1, len(loaded)):
                for a in range(m):
                    y[a] = 0j
                    for k in range(first, last):
                        y[a] += weight[k - first] * complex(
                            loaded[c, fingers[f], a, 0, k], loaded[c, fingers[f], a, 1, k]
                        )
                for a in range(m):
                    for b in range(m):
                        out[f, a, b] += np.conj(y[a]) * y[b] / (len(loaded) - 1)


@njit(cache=True)
def _solve_exactly(N, D, p, usable, wanted, sharpness, a):  # type: ignore[no-untyped-def]  # numba
    """The best drive at one frequency, in place, from a drive next to it; its ratio, or -1: not loud enough."""
    m = len(a)
    is_simple = len(N) == 1 and len(D) == 1
    if is_simple:
        value = solve_dominant(N[0], D[0], a, POWER_STEPS, np.empty((3, m + 1, m), dtype=np.complex128))
        if loudness_of(p, a) >= wanted or wanted <= 0.0:
            return value
        if m <= 2 and len(p) == 1:
            return _on_limit(N, D, p, usable, wanted, a)
    if wanted > 0.0 and loudness_of(p, a) < wanted and keep_level(N, D, p, usable, wanted, a) < 0.0:
        return -1.0
    levels = np.empty((len(p), m, m), dtype=np.complex128)
    for f in range(len(p)):
        for i in range(m):
            for j in range(m):
                levels[f, i, j] = np.conj(p[f, i]) * p[f, j]
    log_wanted = np.log(wanted * _LEVEL_MARGIN) if wanted > 0.0 else -700.0
    multipliers = np.empty(len(N) + len(D) + len(p) + m)
    climb(a, usable, N, D, levels, log_wanted, sharpness, SHARPEST, multipliers)
    if wanted > 0.0 and loudness_of(p, a) < wanted:
        return -1.0
    return ratio_of(N, D, a)


@njit(cache=True)
def _solve_loudest(p, usable, sharpness, a):  # type: ignore[no-untyped-def]  # numba
    """The loudest drive at one frequency, in place; its loudness. Several felt fingers: ascent from what steps find."""
    m = len(a)
    found = find_loudest(p, usable, a)
    if len(p) == 1 or m == 1:
        return found
    levels, each = np.empty((len(p), m, m), dtype=np.complex128), np.zeros((m, m, m), dtype=np.complex128)
    for f in range(len(p)):
        for i in range(m):
            for j in range(m):
                levels[f, i, j] = np.conj(p[f, i]) * p[f, j]
    for i in range(m):
        each[i, i, i] = 1.0
    climb(a, usable, levels, each, levels[:0], -700.0, sharpness, SHARPEST, np.empty(len(p) + 2 * m))
    return loudness_of(p, a)


@njit(cache=True)
def _on_limit(N, D, p, usable, wanted, a):  # type: ignore[no-untyped-def]  # numba
    """At most two actuators and one felt finger, the level binding: closed form."""
    playing, one = 0, 0
    for i in range(len(a)):
        if usable[i]:
            playing, one = playing + 1, i
    if playing == 2:
        return solve_on_limit(N[0], D[0], p[0], wanted, a)
    if abs(p[0, one]) ** 2 < wanted:
        return -1.0
    a[:] = 0j
    a[one] = 1.0
    return ratio_of(N, D, a)


@njit(cache=True)
def _scan(hz, usable, loaded, felt, numerator, denominator, wanted, value, drive):  # type: ignore[no-untyped-def]  # numba
    """Fill value (frequency,) and drive (frequency, actuator) with a drive that keeps the level at each frequency.

    value: its ratio, -1 where no drive is loud enough. Exact with one numerator and one denominator and up to two
    actuators; else a start for the ascent.
    """
    m = drive.shape[1]
    n, d = len(numerator), len(denominator)
    N, D = np.empty((n, m, m), dtype=np.complex128), np.empty((d, m, m), dtype=np.complex128)
    p = np.empty((len(felt), m), dtype=np.complex128)
    a = np.ones(m, dtype=np.complex128)
    weight_n, weight_d, weight_a = np.full(n, 1.0 / n), np.full(d, 1.0 / d), np.full(m, 1.0 / m)
    best, steps, nu = 0.0, _FIRST_STEPS, 0.0
    work = np.zeros((3, m + 1, m), dtype=np.complex128)
    is_simple = n == 1 and d == 1
    value[:] = -1.0
    for visit in range(2 * len(hz)):
        # Some frequencies first: what they reach says where else the search for the level is worth its time.
        k = visit % len(hz)
        if (k % _STRIDE == 0) != (visit < len(hz)) or not usable[k].any():
            continue
        _unpack(numerator, k, m, N)
        _unpack(denominator, k, m, D)
        for f in range(len(felt)):
            for i in range(m):
                p[f, i] = complex(loaded[0, felt[f], i, 0, k], loaded[0, felt[f], i, 1, k])
        if not usable[k].all():
            _mute(usable[k], N, D, p)
        if is_simple:
            for i in range(m):
                a[i] = np.conj(p[0, i])
            ratio = solve_dominant(N[0], D[0], a, _SCAN_STEPS, work)
        else:
            weigh(N, D, a, weight_n, weight_d, weight_a, 0.0, steps, work)
            steps = _STEPS
            ratio = ratio_of(N, D, a)
        drive[k] = a
        if wanted > 0.0 and loudness_of(p, a) < wanted:
            # With one ratio the unlimited optimum bounds what the level leaves; else it is not quite the optimum.
            if ratio <= best * (_NEAR if is_simple else _NEAR_SEVERAL):
                continue
            # Between two frequencies that reached little, little is expected.
            before, after = k - k % _STRIDE, min(k - k % _STRIDE + _STRIDE, len(hz) - 1)
            if min(value[before], value[after]) >= 0.0 and max(value[before], value[after]) < _NEAR_FIRST * best:
                continue
            if is_simple and m <= 2 and len(felt) == 1:
                ratio = _on_limit(N, D, p, usable[k], wanted, drive[k])
            elif find_loudest(p, usable[k], drive[k]) < wanted:
                continue
            else:
                drive[k] = a
                nu = approach_level(N, D, p, wanted, drive[k], weight_n, weight_d, weight_a, nu, work)
                ratio = ratio_of(N, D, drive[k])
                if loudness_of(p, drive[k]) < wanted:
                    ratio = keep_level(N, D, p, usable[k], wanted, drive[k])
        value[k] = ratio
        best = max(best, ratio)


@njit(cache=True)
def _scan_loudest(usable, loaded, felt, value, drive):  # type: ignore[no-untyped-def]  # numba
    """As `_scan`, of the loudest drives."""
    m = drive.shape[1]
    p = np.empty((len(felt), m), dtype=np.complex128)
    for k in range(len(value)):
        for f in range(len(felt)):
            for i in range(m):
                y = complex(loaded[0, felt[f], i, 0, k], loaded[0, felt[f], i, 1, k])
                p[f, i] = y if usable[k, i] else 0j
        value[k] = find_loudest(p, usable[k], drive[k])


@njit(cache=True)
def _evaluate(task, usable, wanted, hz, sharpness, a):  # type: ignore[no-untyped-def]  # numba
    """The best drive at one frequency, in place, from a drive next to it; what it reaches, -1 where it is not loud."""
    grid_hz, loaded, felt, quiet, numerator, denominator, is_share = task
    m = len(a)
    N = np.empty((len(numerator), m, m), dtype=np.complex128)
    D = np.empty((len(denominator), m, m), dtype=np.complex128)
    p = np.empty((len(felt), m), dtype=np.complex128)
    _forms_at(hz, grid_hz, loaded, felt, quiet, numerator, denominator, is_share, N, D, p)
    if not usable.all():
        _mute(usable, N, D, p)
    if np.isinf(wanted):
        return _solve_loudest(p, usable, sharpness, a)
    return _solve_exactly(N, D, p, usable, wanted, sharpness, a)


@njit(cache=True)
def _refine(task, usable, k, wanted, best, a):  # type: ignore[no-untyped-def]  # numba
    """Refine the drive `a` of the grid's frequency k, in place, from its ratio `best`; its frequency and ratio.

    Uphill along the grid first, since the scan is not exact everywhere; then golden section between the neighbours. The
    drive follows from each frequency to the next. The frequency ends on a step of the wire.
    """
    grid_hz, count, playing = task[0], len(task[0]), usable[k]
    is_exact = np.isinf(wanted) or (len(task[4]) == 1 and len(task[5]) == 1 and len(a) <= 2)
    trial = a.copy()
    for side in (-1, 1):
        moved = False
        while not is_exact and 0 <= k + side < count and (usable[k + side] == playing).all():
            trial[:] = a
            value = _evaluate(task, playing, wanted, grid_hz[k + side], _NEXT_SHARPNESS, trial)
            if value <= best:
                break
            best, k, moved = value, k + side, True
            a[:] = trial
        if moved:
            break
    best_hz = grid_hz[k]
    # Between neighbours that the same actuators may play.
    below, above = max(k - 1, 0), min(k + 1, count - 1)
    low = grid_hz[below] if (usable[below] == playing).all() else best_hz
    high = grid_hz[above] if (usable[above] == playing).all() else best_hz
    x, y = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    value_x = value_y = -2.0  # not evaluated yet
    for _ in range(0 if high <= low else _SECTIONS if is_exact else _FEW_SECTIONS):
        now_hz = x if value_x == -2.0 else y
        trial[:] = a
        value = _evaluate(task, playing, wanted, now_hz, _NEXT_SHARPNESS, trial)
        if value > best:
            best, best_hz = value, now_hz
            a[:] = trial
        if value_x == -2.0:
            value_x = value
        else:
            value_y = value
        if value_x > -2.0 and value_y > -2.0:
            if value_x >= value_y:
                high, y, value_y = y, x, value_x
                x, value_x = high - _GOLDEN * (high - low), -2.0
            else:
                low, x, value_x = x, y, value_y
                y, value_y = low + _GOLDEN * (high - low), -2.0
    # The step of the wire next to it; where that is not loud enough, the grid's frequency, which is such a step.
    for now_hz in (np.round(best_hz * 100) / 100, grid_hz[k]):
        trial[:] = a
        value = _evaluate(task, playing, wanted, now_hz, _NEXT_SHARPNESS, trial)
        if value >= 0.0:
            a[:] = trial
            return now_hz, value
    return best_hz, -1.0


_REAL = types.Array(types.float64, 1, "C", readonly=True)
_USABLE = types.Array(types.boolean, 2, "C", readonly=True)
_LOADED = types.Array(types.float32, 5, "C", readonly=True)
_INDEX = types.Array(types.int64, 1, "C", readonly=True)
_PACKED = types.Array(types.float64, 3, "C", readonly=True)
_FOUND = types.Array(types.float64, 1, "C")
_DRIVE = types.Array(types.complex128, 1, "C")
_POWER = types.Array(types.float64, 2, "C")


@njit(
    types.void(
        _REAL, _USABLE, _LOADED, _INDEX, _INDEX, _PACKED, _PACKED, types.boolean, types.float64, _FOUND, _DRIVE, _POWER
    ),
    cache=True,
)
def find_drive(hz, usable, loaded, felt, quiet, numerator, denominator, is_share, wanted, found, out, power):  # type: ignore[no-untyped-def]  # numba
    """Fill out (actuator,) with the best drive, found (2,) with its frequency and its ratio, or -1: none is loud.

    power (case, finger): filled with the powers over threshold under all fingers, the drive's strongest actuator at 1.

    hz (frequency,), usable (frequency, actuator), loaded (case, finger, actuator, 2, frequency) with the standard case
    first, felt and quiet: indices of fingers, numerator and denominator (form, part, frequency), wanted: power over
    threshold under the weakest felt finger with the strongest actuator at 1; infinite asks for the loudest drive.
    """
    count, m = len(hz), len(out)
    value, drive = np.empty(count), np.empty((count, m), dtype=np.complex128)
    if np.isinf(wanted):
        _scan_loudest(usable, loaded, felt, value, drive)
    else:
        _scan(hz, usable, loaded, felt, numerator, denominator, wanted, value, drive)
    is_exact = len(numerator) == 1 and len(denominator) == 1 and m <= 2
    near = value.max() * (_NEAR if is_exact else _NEAR_SEVERAL)
    task = (hz, loaded, felt, quiet, numerator, denominator, is_share)
    peak, peak_value = np.empty(_PEAKS, dtype=np.int64), np.full(_PEAKS, -1.0)
    for i in range(_PEAKS):
        # The best peak that is left; it is taken off the list with the slopes that lead to it.
        k = int(value.argmax())
        if value[k] < near or value[k] < 0.0:
            break
        left, right = k, k
        while left > 0 and value[left - 1] <= value[left] and (usable[left - 1] == usable[k]).all():
            left -= 1
        while right < count - 1 and value[right + 1] <= value[right] and (usable[right + 1] == usable[k]).all():
            right += 1
        value[left : right + 1] = -1.0
        peak[i] = k
        peak_value[i] = _evaluate(task, usable[k], wanted, hz[k], _FIRST_SHARPNESS, drive[k])
    found[0], found[1], top = hz[0], -1.0, peak_value.max()
    for i in range(_PEAKS):
        if peak_value[i] < 0.0 or peak_value[i] < _CLOSE * top:
            continue
        k = peak[i]
        now_hz, now = _refine(task, usable, k, wanted, peak_value[i], drive[k])
        if now > found[1]:
            found[0], found[1] = now_hz, now
            out[:] = drive[k]
    if found[1] >= 0.0:
        out /= np.abs(out).max()
        _fill_power(hz, found[0], loaded, out, power)
