"""Kernels of the sweeps: localized factor, peak and dead spot of every zone over frequency, amplitude and phase.

`fill_pair_sweep` takes two actuators at two frequencies, where magnitudes add (paper eqs. (8), (10)).
`fill_coherent_sweep` takes all actuators at one frequency, where complex fields add (docs/theory.md, tabulated
quantities). Both have the amplitude combinations in the innermost loop, so that a point is loaded once and serves all
of them in vector registers.
"""

from dataclasses import dataclass
from math import gcd

import numpy as np
from numba import prange, types

from base.arrays import Integers, Single
from base.compiled import njit

_F1 = types.Array(types.float32, 1, "C", readonly=True)
_F2 = types.Array(types.float32, 2, "C", readonly=True)
_F3 = types.Array(types.float32, 3, "C", readonly=True)
_F4 = types.Array(types.float32, 4, "C", readonly=True)
_I1 = types.Array(types.int64, 1, "C", readonly=True)
# No NaN inside. The loop of a parallel kernel is compiled once more where it comes from the cache: operations that may
# be fused or reordered would have other last digits there.
_FAST = {"nnan", "nsz"}
_OUT3 = types.Array(types.float32, 3, "C")
_OUT4 = types.Array(types.float32, 4, "C")


@dataclass(frozen=True)
class AmplitudeRatios:
    """The amplitude pairs of a grid 0, 1/n ... 1, folded: the localized factor depends on their ratio only.

    `first`, `second`: shape (ratio,), the smallest pair of each ratio; `ratio`, `multiple`: shape
    (amplitude_1, amplitude_2), such that pair = multiple * smallest pair. The pair (0, 0) has multiple 0.
    """

    first: Single
    second: Single
    ratio: Integers
    multiple: Integers


def fold_amplitudes(steps: int) -> AmplitudeRatios:
    """The ratios of a grid with `steps` steps from 0 to 1."""
    pairs = [(p, q) for p in range(steps + 1) for q in range(steps + 1) if gcd(p, q) == 1]
    index = {pair: i for i, pair in enumerate(pairs)}
    ratio = np.zeros((steps + 1, steps + 1), dtype=np.int64)
    multiple = np.zeros_like(ratio)
    for p in range(steps + 1):
        for q in range(steps + 1):
            if divisor := gcd(p, q):
                ratio[p, q], multiple[p, q] = index[p // divisor, q // divisor], divisor
    smallest = np.array(pairs, dtype=np.float32) / np.float32(steps)
    return AmplitudeRatios(smallest[:, 0].copy(), smallest[:, 1].copy(), ratio, multiple)


@njit(fastmath=_FAST, inline="always")
def _widen(level_a, level_b, v, high, low):  # type: ignore[no-untyped-def]  # numba
    """Widen high, low (frequency_2) by level_a + v level_b at eight points: level_a (8,), level_b (8, frequency_2).

    Eight points a pass and frequencies in vector registers: twice as fast as a reduction over the points.
    """
    a0, a1, a2, a3 = level_a[0], level_a[1], level_a[2], level_a[3]
    a4, a5, a6, a7 = level_a[4], level_a[5], level_a[6], level_a[7]
    for f in range(high.shape[0]):
        x0, x1 = a0 + v * level_b[0, f], a1 + v * level_b[1, f]
        x2, x3 = a2 + v * level_b[2, f], a3 + v * level_b[3, f]
        x4, x5 = a4 + v * level_b[4, f], a5 + v * level_b[5, f]
        x6, x7 = a6 + v * level_b[6, f], a7 + v * level_b[7, f]
        high[f] = max(max(max(x0, x1), max(x2, x3)), max(max(x4, x5), max(max(x6, x7), high[f])))
        low[f] = min(min(min(x0, x1), min(x2, x3)), min(min(x4, x5), min(min(x6, x7), low[f])))


@njit(
    types.void(_F3, _F3, _F2, _F2, _F1, _F1, _F1, _F1, _I1, _F1, _OUT4, _OUT4, _OUT4),
    cache=True,
    parallel=True,
    fastmath=_FAST,
)
def fill_pair_sweep(  # type: ignore[no-untyped-def]  # numba
    level_1, level_2, energy_1, energy_2, total_1, total_2, first, second, ratio, scale, factor, peak, dead
):
    """Fill factor, peak, dead (frequency_1, combination, zone, frequency_2); all inputs float32.

    level_1 (frequency_1, zone, point), level_2 (zone, point, frequency_2): |A_i|, m/s^2 at full scale, a multiple of
    8 points; energy_1 (frequency_1, zone), energy_2 (zone, frequency_2), total_i (frequency_i): diagonals of the Gram
    matrices; first, second (ratio): see AmplitudeRatios; ratio, scale (combination): which ratio, times what. A
    combination with scale 0 is NaN: nothing moves.
    """
    zones, points, count_2 = level_2.shape
    ratios = first.shape[0]
    # One row of the table a thread: everything of one frequency of the first actuator.
    for f1 in prange(level_1.shape[0]):
        high = np.zeros((ratios, zones, count_2), dtype=np.float32)
        low = np.full((ratios, zones, count_2), np.float32(3.4e38))
        share = np.empty((ratios, zones, count_2), dtype=np.float32)
        # Once for each ratio of amplitudes: greatest and least level, and share of the energy.
        for r in range(ratios):
            power_1, power_2 = first[r] * first[r], second[r] * second[r]
            for z in range(zones):
                level_a = first[r] * level_1[f1, z]
                for p in range(0, points, 8):
                    _widen(level_a[p : p + 8], level_2[z, p : p + 8], second[r], high[r, z], low[r, z])
                for f2 in range(count_2):
                    share[r, z, f2] = (power_1 * energy_1[f1, z] + power_2 * energy_2[z, f2]) / (
                        power_1 * total_1[f1] + power_2 * total_2[f2]
                    )
        # Then each pair of amplitudes is a multiple of its ratio's smallest pair.
        for k in range(ratio.shape[0]):
            r, s = ratio[k], scale[k]
            for z in range(zones):
                for f2 in range(count_2):
                    factor[f1, k, z, f2] = share[r, z, f2]
                    peak[f1, k, z, f2] = s * high[r, z, f2]
                    dead[f1, k, z, f2] = s * low[r, z, f2]
            if s == 0:  # nothing moves
                factor[f1, k], peak[f1, k], dead[f1, k] = np.nan, np.nan, np.nan


@njit(fastmath=_FAST, inline="always")
def _quadratic_form(gram_real, gram_imag, drive_real, drive_imag, out):  # type: ignore[no-untyped-def]  # numba
    """Fill out (direction,) with a^H R a for the Hermitian R (actuator, actuator) and the columns a of drive."""
    actuators, directions = drive_real.shape
    for d in range(directions):
        out[d] = np.float32(0.0)
    for i in range(actuators):
        for j in range(actuators):
            re, im = gram_real[i, j], gram_imag[i, j]
            for d in range(directions):
                both_real = drive_real[i, d] * drive_real[j, d] + drive_imag[i, d] * drive_imag[j, d]
                both_imag = drive_real[i, d] * drive_imag[j, d] - drive_imag[i, d] * drive_real[j, d]
                out[d] += re * both_real - im * both_imag


@njit(
    types.void(_F4, _F4, _F4, _F4, _F3, _F3, _F2, _F2, _OUT3, _OUT3, _OUT3), cache=True, parallel=True, fastmath=_FAST
)
def fill_coherent_sweep(  # type: ignore[no-untyped-def]  # numba
    real, imag, gram_real, gram_imag, total_real, total_imag, drive_real, drive_imag, factor, peak, dead
):
    """Fill factor, peak, dead (frequency, zone, direction) for complex amplitude vectors ("directions").

    real, imag (frequency, actuator, zone, point): A, m/s^2 at full scale; gram (frequency, zone, actuator, actuator)
    and total (frequency, actuator, actuator); drive (actuator, direction).
    """
    count, actuators, zones, points = real.shape
    directions = drive_real.shape[1]
    for f in prange(count):
        total = np.empty(directions, dtype=np.float32)
        field_real = np.empty(directions, dtype=np.float32)
        field_imag = np.empty(directions, dtype=np.float32)
        _quadratic_form(total_real[f], total_imag[f], drive_real, drive_imag, total)
        for z in range(zones):
            # Localized factor: the zone's energy over that of the bar.
            _quadratic_form(gram_real[f, z], gram_imag[f, z], drive_real, drive_imag, factor[f, z])
            for d in range(directions):
                factor[f, z, d] /= total[d]
                peak[f, z, d] = np.float32(0.0)
                dead[f, z, d] = np.float32(np.inf)
            # Squared magnitude of the field at every point; roots are taken once at the end.
            for p in range(points):
                for d in range(directions):
                    field_real[d] = np.float32(0.0)
                    field_imag[d] = np.float32(0.0)
                for a in range(actuators):
                    re, im = real[f, a, z, p], imag[f, a, z, p]
                    for d in range(directions):
                        field_real[d] += re * drive_real[a, d] - im * drive_imag[a, d]
                        field_imag[d] += re * drive_imag[a, d] + im * drive_real[a, d]
                for d in range(directions):
                    value = field_real[d] * field_real[d] + field_imag[d] * field_imag[d]
                    peak[f, z, d] = max(peak[f, z, d], value)
                    dead[f, z, d] = min(dead[f, z, d], value)
            for d in range(directions):
                peak[f, z, d] = np.sqrt(peak[f, z, d])
                dead[f, z, d] = np.sqrt(dead[f, z, d])
