"""Kernels of the search: the ascent (precompute.entries.ascent) with the frequencies free, from many starts at once."""

import numpy as np
from numba import types

from engine.compiled import njit
from engine.steady.forms import copy_drive
from precompute.entries.ascent import PENALTY, SHARPEST, climb

_SWEEPS = 3  # over the frequencies of several tones, since they depend on one another
_FIRST = 30.0
_ALONG = SHARPEST / 10  # first sharpness of a climb that starts next to a climbed drive
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
def interpolate(stack, grid_hz, frequency_hz, tone, out):  # type: ignore[no-untyped-def]  # numba
    """Forms (form, actuator, actuator) of a drive with tones at frequency_hz (tone,), tone (actuator,) each one's.

    Cubic through four neighbours of the grid; actuators on different tones do not interfere.
    """
    count, m = len(grid_hz), len(tone)
    for i in range(stack.shape[0]):
        for a in range(m):
            for r in range(m):
                out[i, a, r] = 0.0
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
    return climb(drive, usable, n, d, p, log_wanted, start, SHARPEST, multipliers, PENALTY)


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
        for k in range(len(hz)):
            trial_hz[k] = hz[k]
        trial_hz[t] = x
        value_x = _at(at_x, usable, stacks, grid_hz, trial_hz, tone, log_wanted, _ALONG, multipliers)
        trial_hz[t] = y
        value_y = _at(at_y, usable, stacks, grid_hz, trial_hz, tone, log_wanted, _ALONG, multipliers)
        while b - a > tolerance:
            if value_x >= value_y:
                b, y, value_y = y, x, value_x
                copy_drive(at_x, at_y)
                x = b - _GOLDEN * (b - a)
                trial_hz[t] = x
                value_x = _at(at_x, usable, stacks, grid_hz, trial_hz, tone, log_wanted, _ALONG, multipliers)
            else:
                a, x, value_x = x, y, value_y
                copy_drive(at_y, at_x)
                y = a + _GOLDEN * (b - a)
                trial_hz[t] = y
                value_y = _at(at_y, usable, stacks, grid_hz, trial_hz, tone, log_wanted, _ALONG, multipliers)
        # The tone moves only if that was better.
        better = max(value_x, value_y)
        if better > value:
            value = better
            hz[t] = x if value_x >= value_y else y
            copy_drive(at_x if value_x >= value_y else at_y, drive)
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
)
def refine(  # type: ignore[no-untyped-def]  # numba
    drives, usable, numerator, denominator, level, grid_hz, hz, tone, low, high, log_wanted, tolerance, multipliers
):
    """Climb from each of `drives` (start, actuator), moving its tones hz (start, tone) between low and high; in place.

    usable, tone (start, actuator). Golden section on each frequency in turn, the drive climbing along; frequencies end
    within `tolerance`; an infinite one keeps them and climbs only the last steps. multipliers (start, form): as
    `evaluate` leaves them at the end.
    """
    for i in range(len(drives)):
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
)
def climb_each(drives, usable, numerator, denominator, level, log_wanted, start, stop, value):  # type: ignore[no-untyped-def]  # numba
    """Climb one drive (frequency, actuator) at each frequency of the stacks; in place, value (frequency,)."""
    for f in range(len(drives)):
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
            PENALTY,
        )
