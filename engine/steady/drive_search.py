"""Kernel: the best drive of one tone over all frequencies, from loaded responses (engine.steady.loading).

Every frequency of the grid gets a drive and its ratio (engine.steady.optimum). The best peaks over frequency are then
refined with the frequency free, between the peak's neighbours; there the responses, not the powers, are interpolated,
since powers under a quiet finger have deep minima. With several fingers, or where the level binds beyond two
actuators, each step of the refinement ends with the ascent of engine.steady.ascent, which is exact at its frequency.
"""

import numpy as np
from numba import types

from engine.steady.ascent import SHARPEST, climb
from engine.steady.forms import DRIVE, REAL, USABLE, copy_drive, fill_products, kernel, loudness_of, ratio_of
from engine.steady.limited import keep_limits
from engine.steady.optimum import find_loudest, keep_level, solve_dominant, weigh

_LEVEL_MARGIN = 1 + 2e-4  # relative, 0.0009 dB: neither smoothing nor rounding leaves a drive short of its level
# Halved or doubled, tried on 198 random placements of 2 to 5 fingers at 20 dB: reference-a, -t, a bar of 3 actuators.
_STEPS, _FIRST_STEPS = 2, 12  # 1 and 6 lose nothing, 4 and 24 gain nothing
_NEAR, _NEAR_SEVERAL = 0.9, 0.5  # peaks whose ratio is above this fraction of the best one's are refined
_PEAKS = 6  # 3 and 12 change nothing
_CLOSE, _REFINED = 0.95, 3  # peaks whose drive is above this fraction of the best are refined, for many fingers three
_STRIDE = 8  # The scan takes every eighth frequency first. The best of them lets it leave out most of the others.
_SCAN_STEPS, _POWER_STEPS = 2, 30  # 1 and 15 lose nothing
_GOLDEN = 0.6180339887498949  # (sqrt(5) - 1) / 2
_SECTIONS, _FEW_SECTIONS = 9, 5  # 5 and 3 lose up to 9.5 dB, 14 and 9 gain up to 0.9 (reference-t)
_SHARPNESS = 1000.0  # of the ascent at its start; a softer objective led away from good starts, by up to 0.8 dB

_HZ = types.Array(types.float64, 1, "C", readonly=True)
_USABLE_AT = types.Array(types.boolean, 2, "C", readonly=True)
_LOADED = types.Array(types.float32, 5, "C", readonly=True)
_INDEX = types.Array(types.int64, 1, "C", readonly=True)
_FORMS = types.Array(types.float64, 3, "C", readonly=True)
_REALS = types.Array(types.float64, 2, "C")
_COMPLEXES = types.Array(types.complex128, 2, "C")
_COUNT, _FLOAT, _FLAG = types.int64, types.float64, types.boolean
_RESPONSES = _LOADED, _INDEX, _COUNT, _FORMS  # with the order of the fingers and how many are felt; powers or energies


@kernel(types.int64(types.float64, _HZ, REAL))
def _weigh_neighbours(hz, grid_hz, weight):  # type: ignore[no-untyped-def]  # numba
    """Fill weight (neighbour,) of the cubic through the grid's four neighbours of a frequency; return their first."""
    first = max(min(np.searchsorted(grid_hz, hz) - 2, len(grid_hz) - len(weight)), 0)
    for k in range(len(weight)):
        weight[k] = 1.0
        for other in range(len(weight)):
            if other != k:
                weight[k] *= (hz - grid_hz[first + other]) / (grid_hz[first + k] - grid_hz[first + other])
    return first


@kernel(types.void(_COUNT, REAL, _LOADED, _INDEX, _COUNT, _FORMS, types.boolean, USABLE, _REALS, _COMPLEXES))
def _fill_forms(first, weight, loaded, order, felt, forms, is_given, usable, out, p):  # type: ignore[no-untyped-def]  # numba
    """Fill out (form + felt, part) with the forms and then the levels, p (felt, actuator) with what levels are made of.

    At a frequency between the lines from `first` on, with their weights: the forms (frequency, form, part) are
    interpolated where `is_given`, else the responses under each finger. Actuators that may not play have no power, no
    response, and quiet forms that stay definite.
    """
    m, count = loaded.shape[2], forms.shape[1]
    y = np.empty(m, dtype=np.complex128)
    out[:] = 0.0
    if is_given:
        for k in range(len(weight)):
            for i in range(count):
                for part in range(m * m):
                    out[i, part] += weight[k] * forms[first + k, i, part]
    # Powers under each finger, a mean over the sampled cases; then the powers of the standard case.
    for i in range(count if is_given else 0, count + felt):
        finger = order[i] if i < count else order[i - count]
        begin, end = (1, len(loaded)) if i < count else (0, 1)
        for c in range(begin, end):
            for a in range(m):
                real, imag = 0.0, 0.0
                for k in range(len(weight)):
                    real += weight[k] * loaded[c, finger, a, 0, first + k]
                    imag += weight[k] * loaded[c, finger, a, 1, first + k]
                y[a] = complex(real, imag) if usable[a] else 0j
            part = m
            for a in range(m):
                out[i, a] += (y[a].real * y[a].real + y[a].imag * y[a].imag) / (end - begin)
                for b in range(a + 1, m):
                    # conj(y_a) y_b
                    out[i, part] += (y[a].real * y[b].real + y[a].imag * y[b].imag) / (end - begin)
                    out[i, part + 1] += (y[a].real * y[b].imag - y[a].imag * y[b].real) / (end - begin)
                    part += 2
        if i >= count:
            for a in range(m):
                p[i - count, a] = y[a]
    for i in range(count):
        trace, part = 1e-300, m
        for a in range(m):
            trace += out[i, a] if usable[a] else 0.0
        for a in range(m):
            if not usable[a]:
                out[i, a] = 0.0 if i < (1 if is_given and count == 2 else felt) else trace
            for b in range(a + 1, m):
                if not (usable[a] and usable[b]):
                    out[i, part], out[i, part + 1] = 0.0, 0.0
                part += 2


@kernel(types.float64(_REALS, _COUNT, _COUNT, _COMPLEXES, USABLE, types.float64, DRIVE))
def _solve_at(forms, felt, quiet, p, usable, wanted, a):  # type: ignore[no-untyped-def]  # numba
    """The best drive at one frequency, in place, from a drive next to it; its ratio, or -1: not loud enough.

    An infinite `wanted` asks for the loudest drive and its loudness.
    """
    m, last = len(a), felt + quiet
    products = np.empty(m * m)
    if np.isinf(wanted):
        found = find_loudest(p, usable, a)
        if len(p) == 1 or m == 1:
            return found
        # The weakest level over the strongest amplitude.
        rows = np.zeros((len(p) + m, m * m))
        for f in range(len(p)):
            for part in range(m * m):
                rows[f, part] = forms[last + f, part]
        for i in range(m):
            rows[len(p) + i, i] = 1.0
        climb(a, usable, rows, len(p), m, 0.0, _SHARPNESS, SHARPEST)
        fill_products(a, products)
        return loudness_of(forms, last, m, products)
    value = 0.0
    if last == 2:
        value = solve_dominant(forms[0], forms[1], a, _POWER_STEPS)
    fill_products(a, products)
    loudness = loudness_of(forms, last, m, products)
    if last == 2 and loudness >= wanted:
        return value
    if loudness < wanted:
        loud = np.empty(m, dtype=np.complex128)
        if find_loudest(p, usable, loud) < wanted:
            return -1.0
        weight, nu, margin = np.full(quiet, 1.0 / quiet), np.zeros(m), wanted * _LEVEL_MARGIN
        value = keep_limits(forms, felt, quiet, p, usable, margin, 0.0, loud, weight, nu, a)
        fill_products(a, products)
        if loudness_of(forms, last, m, products) < wanted:
            keep_level(forms, felt, quiet, p, usable, wanted, a)
        elif last == 2 and len(p) == 1:
            return value
    climb(a, usable, forms, felt, quiet, np.log(max(wanted, 1e-300) * _LEVEL_MARGIN), _SHARPNESS, SHARPEST)
    fill_products(a, products)
    if loudness_of(forms, last, m, products) < wanted:
        return keep_level(forms, felt, quiet, p, usable, wanted, a)
    return ratio_of(forms, felt, quiet, products)


@kernel(types.void(_USABLE_AT, _LOADED, _INDEX, _COUNT, _FORMS, _COUNT, types.float64, REAL, _COMPLEXES))
def _scan(usable, loaded, order, felt, given, numerators, wanted, value, drive):  # type: ignore[no-untyped-def]  # numba
    """Fill value (frequency,) and drive (frequency, actuator) with about the best drive at each frequency.

    value: about its ratio, -1 where no drive is loud enough. Where the level binds, the optimum without it bounds what
    is left: where that is little, it stands for it. Exact with one numerator and one denominator and up to two
    actuators; else a start for the ascent.
    """
    count, m = drive.shape
    n, last = numerators, given.shape[1]
    d = last - n
    forms, p, one = np.empty((last + felt, m * m)), np.empty((felt, m), dtype=np.complex128), np.ones(1)
    a, loud, products = np.ones(m, dtype=np.complex128), np.empty(m, dtype=np.complex128), np.empty(m * m)
    weight, held_weight, nu = np.empty(last), np.full(d, 1.0 / d), np.zeros(m)
    weight[:n], weight[n:] = 1.0 / n, 1.0 / d
    mixed, space = np.zeros((3, m * m)), np.zeros((m + 2, m), dtype=np.complex128)
    best, steps = 0.0, _FIRST_STEPS
    is_simple = last == 2
    value[:] = -1.0
    for visit in range(2 * count):
        k = visit % count
        if (k % _STRIDE == 0) != (visit < count) or not usable[k].any():
            continue
        _fill_forms(k, one, loaded, order, felt, given, True, usable[k], forms, p)
        if np.isinf(wanted):
            value[k] = find_loudest(p, usable[k], drive[k])
            continue
        if is_simple:
            for i in range(m):
                a[i] = np.conj(p[0, i])
            ratio = solve_dominant(forms[0], forms[1], a, _SCAN_STEPS)
            fill_products(a, products)
        else:
            weigh(forms, n, d, a, weight, steps, mixed, space)
            fill_products(a, products)
            ratio, steps = ratio_of(forms, n, d, products), _STEPS
        copy_drive(a, drive[k])
        if loudness_of(forms, last, m, products) < wanted:
            if find_loudest(p, usable[k], loud) < wanted:
                continue
            floor = best * (_NEAR if is_simple and m <= 2 else _NEAR_SEVERAL)
            if ratio > floor:
                ratio = keep_limits(forms, n, d, p, usable[k], wanted, floor, loud, held_weight, nu, drive[k])
        value[k] = ratio
        best = max(best, ratio)


@kernel(_FLOAT(_FLOAT, _HZ, *_RESPONSES, _COUNT, _FLAG, USABLE, _FLOAT, DRIVE))
def _evaluate(hz, grid_hz, loaded, order, felt, given, numerators, is_share, usable, wanted, a):  # type: ignore[no-untyped-def]  # numba
    """The best drive at one frequency, in place, from a drive next to it; what it reaches, -1 where it is not loud."""
    m, last = len(a), given.shape[1]
    weight, forms = np.empty(min(4, len(grid_hz))), np.empty((last + felt, m * m))
    p = np.empty((felt, m), dtype=np.complex128)
    first = _weigh_neighbours(hz, grid_hz, weight)
    _fill_forms(first, weight, loaded, order, felt, given, is_share, usable, forms, p)
    return _solve_at(forms, numerators, last - numerators, p, usable, wanted, a)


@kernel(types.void(_HZ, _USABLE_AT, *_RESPONSES, _COUNT, _FLAG, _FLAG, _FLOAT, _COUNT, REAL, DRIVE))
def _refine(hz, usable, loaded, order, felt, given, numerators, is_share, between, wanted, k, found, a):  # type: ignore[no-untyped-def]  # numba
    """Refine the drive `a` of the grid's frequency k, in place, and found (2,): its frequency and its ratio.

    Uphill along the grid first, since the scan is not exact everywhere; then, where responses may be read `between`
    the grid's frequencies, golden section between the neighbours. The drive follows from each frequency to the next.
    The frequency ends on a step of the wire.
    """
    count, playing, trial = len(hz), usable[k], a.copy()
    is_exact = np.isinf(wanted) or (given.shape[1] == 2 and len(a) <= 2)
    # Steps: along the grid to one side, or else to the other, then sections, then the steps of the wire.
    side, moved, section, sections = -1, False, 0, _SECTIONS if is_exact else _FEW_SECTIONS
    sections *= between
    is_uphill, at_hz, best = not is_exact, hz[k], found[1]
    low = high = x = y = best_hz = hz[k]
    value_x = value_y = -2.0  # not evaluated yet
    while True:
        if is_uphill and (k + side < 0 or k + side >= count or not (usable[k + side] == playing).all()):
            is_uphill, side = side < 0 and not moved, 1
            if is_uphill:
                continue
        if is_uphill:
            at_hz = hz[k + side]
        elif section == 0:
            # Between neighbours that the same actuators may play.
            below, above = max(k - 1, 0), min(k + 1, count - 1)
            best_hz = hz[k]
            low = hz[below] if (usable[below] == playing).all() else best_hz
            high = hz[above] if (usable[above] == playing).all() else best_hz
            x, y = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
            at_hz, section = x, 1 if high > low else sections + 1
        if section > sections:
            # The step of the wire next to it, or else the grid's frequency, which is such a step.
            at_hz = np.round(best_hz * 100) / 100 if section == sections + 1 else hz[k]
        elif section > 0:
            at_hz = x if value_x == -2.0 else y
        copy_drive(a, trial)
        value = _evaluate(at_hz, hz, loaded, order, felt, given, numerators, is_share, playing, wanted, trial)
        if is_uphill:
            if value > best:
                best, k, moved = value, k + side, True
                copy_drive(trial, a)
            else:
                is_uphill, side = side < 0 and not moved, 1
            continue
        if section > sections:
            if value >= 0.0:
                copy_drive(trial, a)
            found[0], found[1] = at_hz, value
            if value >= 0.0 or section == sections + 2:
                return
            section += 1
            continue
        section += 1
        if value > best:
            best, best_hz = value, at_hz
            copy_drive(trial, a)
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


@kernel(types.void(_HZ, types.float64, _LOADED, DRIVE, _REALS))
def _fill_power(grid_hz, hz, loaded, a, power):  # type: ignore[no-untyped-def]  # numba
    """Fill power (case, finger) with the power of a drive under every finger."""
    weight = np.empty(min(4, len(grid_hz)))
    first = _weigh_neighbours(hz, grid_hz, weight)
    for c in range(power.shape[0]):
        for f in range(power.shape[1]):
            y = 0j
            for i in range(len(a)):
                for k in range(len(weight)):
                    y += weight[k] * complex(loaded[c, f, i, 0, first + k], loaded[c, f, i, 1, first + k]) * a[i]
            power[c, f] = y.real * y.real + y.imag * y.imag


@kernel(types.void(REAL, _COUNT))
def _keep_peak(value, held):  # type: ignore[no-untyped-def]  # numba
    """Keep the peak of value (frequency,) uphill of the index `held`, the nearest at the level; the rest is -1."""
    count, k = len(value), held
    for away in range(count):
        if value[max(held - away, 0)] >= 0.0 or value[min(held + away, count - 1)] >= 0.0:
            k = max(held - away, 0) if value[max(held - away, 0)] >= 0.0 else min(held + away, count - 1)
            break
    while True:
        before, after = value[max(k - 1, 0)], value[min(k + 1, count - 1)]
        if max(before, after) <= value[k]:
            break
        k += 1 if after >= before else -1
    left, right = k, k
    while left > 0 and value[left - 1] <= value[left]:
        left -= 1
    while right < count - 1 and value[right + 1] <= value[right]:
        right += 1
    value[:left], value[right + 1 :] = -1.0, -1.0


@kernel(types.void(_HZ, _USABLE_AT, *_RESPONSES, _FLAG, _FLAG, _FLOAT, _COUNT, REAL, DRIVE, _REALS))
def find_drive(hz, usable, loaded, order, felt, given, is_share, between, wanted, held, found, out, power):  # type: ignore[no-untyped-def]  # numba
    """Fill out (actuator,) with the best drive, found (2,) with its frequency and its ratio; -1: no drive is loud.

    power (case, finger): filled with the powers over threshold under all fingers, the drive's strongest actuator at 1.

    hz (frequency,), usable (frequency, actuator), loaded (case, finger, actuator, 2, frequency) with the standard case
    first. order: indices of the fingers, the `felt` ones first. given (frequency, form, part): the powers under the
    fingers in that order, or with `is_share` two energies. between: whether `hz` is dense enough at resonances for
    responses between its frequencies. wanted: power over threshold under the weakest felt finger
    with the strongest actuator at 1; infinite asks for the loudest drive. held: index of a frequency whose peak alone
    is searched; -1 for all.
    """
    count, m = len(hz), len(out)
    n = 1 if is_share else felt
    value, drive = np.empty(count), np.empty((count, m), dtype=np.complex128)
    _scan(usable, loaded, order, felt, given, n, wanted, value, drive)
    if held >= 0:
        _keep_peak(value, held)
    near = value.max() * (_NEAR if given.shape[1] == 2 and m <= 2 else _NEAR_SEVERAL)
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
        peak_value[i] = _evaluate(hz[k], hz, loaded, order, felt, given, n, is_share, usable[k], wanted, drive[k])
    found[0], found[1], top, refined = hz[0], -1.0, peak_value.max(), np.empty(2)
    for _ in range(_PEAKS if given.shape[1] <= 3 else _REFINED):
        i = int(peak_value.argmax())
        if peak_value[i] < 0.0 or peak_value[i] < _CLOSE * top:
            break
        k = peak[i]
        refined[1] = peak_value[i]
        peak_value[i] = -1.0
        _refine(hz, usable, loaded, order, felt, given, n, is_share, between, wanted, k, refined, drive[k])
        if refined[1] > found[1]:
            found[0], found[1] = refined[0], refined[1]
            copy_drive(drive[k], out)
    if found[1] >= 0.0:
        out /= np.abs(out).max()
        _fill_power(hz, found[0], loaded, out, power)
