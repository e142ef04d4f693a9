"""Kernels that scan: the best direction at every frequency, and the best second tone to every first one."""

import numpy as np
from numba import types

from engine.compiled import njit

_PACKED = types.Array(types.float32, 3, "C", readonly=True)
_DIRECTIONS = types.Array(types.float32, 2, "C", readonly=True)
_LEVELS = types.Array(types.float32, 1, "C", readonly=True)
_SCORE = types.Array(types.float32, 2, "C")
_ARG = types.Array(types.int64, 2, "C")
_POWERS = types.Array(types.float64, 2, "C", readonly=True)
_REAL = types.Array(types.float64, 1, "C", readonly=True)
_HZ = types.Array(types.float64, 1, "C")


@njit(cache=True)
def _fill_powers(form, directions, out):  # type: ignore[no-untyped-def]  # numba
    """Fill out (direction,) with the powers of one packed form (part,).

    The innermost loop runs over directions, which are contiguous: the compiler keeps them in vector registers.
    """
    out[:] = 0.0
    for c in range(directions.shape[0]):
        for d in range(directions.shape[1]):
            out[d] += form[c] * directions[c, d]


@njit(types.void(_PACKED, _PACKED, _PACKED, _DIRECTIONS, _LEVELS, _SCORE, _ARG), cache=True)
def scan(numerator, denominator, level, directions, wanted, score, arg):  # type: ignore[no-untyped-def]  # numba
    """Best of many directions at every frequency: ratio above each level, and the loudest.

    Forms (form, frequency, part) and directions (part, direction) as real vectors whose product is a^H H a, the
    strongest actuator of a direction at 1. score, arg (frequency, level + 1): the last is the greatest min P; ratio -1:
    no direction is loud enough.
    """
    count = directions.shape[1]
    for f in range(numerator.shape[1]):
        least = np.empty(count, dtype=np.float32)
        greatest = np.empty(count, dtype=np.float32)
        loud = np.empty(count, dtype=np.float32)
        value = np.empty(count, dtype=np.float32)
        least[:], greatest[:], loud[:] = np.inf, 0.0, np.inf
        # Least numerator, greatest denominator and least level of every direction.
        for i in range(numerator.shape[0]):
            _fill_powers(numerator[i, f], directions, value)
            for d in range(count):
                least[d] = min(least[d], value[d])
        for i in range(denominator.shape[0]):
            _fill_powers(denominator[i, f], directions, value)
            for d in range(count):
                greatest[d] = max(greatest[d], value[d])
        for i in range(level.shape[0]):
            _fill_powers(level[i, f], directions, value)
            for d in range(count):
                loud[d] = min(loud[d], value[d])
        # The best direction for each wanted level, and last the loudest one.
        for w in range(len(wanted) + 1):
            score[f, w], arg[f, w] = -1.0, 0
        for d in range(count):
            ratio = least[d] / greatest[d]
            for w in range(len(wanted)):
                if loud[d] >= wanted[w] and ratio > score[f, w]:
                    score[f, w], arg[f, w] = ratio, d
            if loud[d] > score[f, len(wanted)]:
                score[f, len(wanted)], arg[f, len(wanted)] = loud[d], d


@njit(
    types.void(
        _POWERS, _POWERS, _REAL, _REAL, types.int64[::1], types.float64, types.float64, _HZ, types.int64[::1], _HZ
    ),
    cache=True,
)
def scan_pairs(first, second, hz, ratios, ends, wanted, apart_hz, best, partner, ratio):  # type: ignore[no-untyped-def]  # numba
    """Best second tone and power ratio for each first one: best, partner, ratio (frequency,); -1: none is loud enough.

    first, second (frequency, form): powers of two drives without common actuators, forms in the order numerators,
    denominators, levels, actuators, which `ends` divides. A ratio that is not loud enough stands for the next that is.
    """
    n, d, p = ends
    forms = first.shape[1]
    for f in range(len(hz)):
        best[f], partner[f], ratio[f] = -1.0, 0, 0.0
        for g in range(len(hz)):
            if abs(hz[f] - hz[g]) < apart_hz:
                continue
            driven_f, driven_g = 0.0, 0.0
            for i in range(p, forms):
                driven_f, driven_g = max(driven_f, first[f, i]), max(driven_g, second[g, i])
            # Each level is to reach `wanted` with either tone's strongest actuator at full scale.
            lowest, highest = 0.0, np.inf
            for i in range(d, p):
                missing, spare = wanted * driven_f - first[f, i], wanted * driven_g - second[g, i]
                if missing > 0.0:
                    lowest = max(lowest, missing / second[g, i]) if second[g, i] > 0.0 else np.inf
                if spare > 0.0:
                    highest = min(highest, first[f, i] / spare)
            if lowest > highest or lowest == np.inf:
                continue
            for each in ratios:  # of the second tone's power to the first's
                r = min(max(each, lowest), highest)
                least, greatest = np.inf, 0.0
                for i in range(n):
                    least = min(least, first[f, i] + r * second[g, i])
                for i in range(n, d):
                    greatest = max(greatest, first[f, i] + r * second[g, i])
                if least > best[f] * greatest:
                    best[f], partner[f], ratio[f] = least / greatest, g, r
