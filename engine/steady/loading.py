"""Kernels that put fingers on the bar: responses under fingers at any positions, and the forms of their powers.

Receptances are interpolated between places by cubics; fingers are attached one after another, each as a rank-one
update (Sherman and Morrison). Frequencies are the innermost axis, real and imaginary parts apart, so that all loops
become vector instructions. Single precision is enough: the deepest minimum under a finger is 1/1000 of the motion.
"""

import numpy as np
from numba import types

from base.compiled import njit

_BLOCK = types.Array(types.float32, 3, "C", readonly=True)
_FIELD = types.Array(types.float32, 4, "C", readonly=True)
_LINE = types.Array(types.float32, 1, "C", readonly=True)
_REAL = types.Array(types.float64, 1, "C", readonly=True)
_POSITION = types.Array(types.float64, 2, "C", readonly=True)
_LOADED = types.Array(types.float32, 5, "C")
_GIVEN = types.Array(types.float32, 5, "C", readonly=True)
_PACKED = types.Array(types.float64, 3, "C")


@njit(cache=True)
def _cubic(at, places, weight):  # type: ignore[no-untyped-def]  # numba
    """Fill weight (4,) of the cubic through four places about `at`, in pitches; return the first of them."""
    first = min(max(int(at) - 1, 0), places - 4)
    x = at - first
    weight[0] = -(x - 1) * (x - 2) * (x - 3) / 6
    weight[1] = x * (x - 2) * (x - 3) / 2
    weight[2] = -x * (x - 1) * (x - 3) / 2
    weight[3] = x * (x - 1) * (x - 2) / 6
    return first


@njit(cache=True)
def _pair(one, other, places):  # type: ignore[no-untyped-def]  # numba
    """Index of a pair of places in the upper triangle."""
    low, high = min(one, other), max(one, other)
    return low * places - low * (low - 1) // 2 + high - low


@njit(fastmath=True, inline="always")
def _subtract_product(x, y, u, v, factor, out):  # type: ignore[no-untyped-def]  # numba
    """Subtract (x + j y) (u + j v) factor from out (2, frequency), elementwise.

    Two loops: where one writes both parts, the compiler would have more arrays to tell apart than it vectorises for.
    """
    real, imag, out_real, out_imag = factor[0], factor[1], out[0], out[1]
    for k in range(len(x)):
        a, b = x[k] * u[k] - y[k] * v[k], x[k] * v[k] + y[k] * u[k]
        out_real[k] -= a * real[k] - b * imag[k]
    for k in range(len(x)):
        a, b = x[k] * u[k] - y[k] * v[k], x[k] * v[k] + y[k] * u[k]
        out_imag[k] -= a * imag[k] + b * real[k]


@njit(fastmath=True, inline="always")
def _spread(power, share, out):  # type: ignore[no-untyped-def]  # numba
    """Add share_i power to out (stretch, frequency)."""
    for i in range(len(share)):
        if share[i] != 0.0:
            for k in range(len(power)):
                out[i, k] += share[i] * power[k]


@njit(
    types.void(_FIELD, _BLOCK, _LINE, types.float64, _POSITION, _BLOCK, types.Array(types.float32, 4, "C"), _LOADED),
    cache=True,
    fastmath=True,
)
def fill_loaded(drive, point, omega, pitch_m, position_m, impedance, g, out):  # type: ignore[no-untyped-def]  # numba
    """Fill out (case, finger, actuator, 2, frequency) with the response under each finger, all fingers on the bar.

    drive (place, actuator, 2, frequency), in any unit; point (pair, 2, frequency), m/N; omega (frequency,), 1/s;
    position_m (case, finger); impedance (case, finger, 3): stiffness, damping, mass; g (finger, finger, 2, frequency):
    space for the receptances between fingers.
    """
    places, actuators, _, count = drive.shape
    cases, fingers = position_m.shape
    cell, weight = np.empty(fingers, dtype=np.int64), np.empty((fingers, 4), dtype=np.float32)
    u, v = np.empty(count, dtype=np.float32), np.empty(count, dtype=np.float32)
    for c in range(cases):
        # The four places about each finger, and the cubic's weights there.
        for p in range(fingers):
            cell[p] = _cubic(position_m[c, p] / pitch_m, places, weight[p])
        # Receptances between fingers (upper triangle), and responses to the actuators, of the untouched bar.
        for p in range(fingers):
            w0, w1, w2, w3 = weight[p, 0], weight[p, 1], weight[p, 2], weight[p, 3]
            for a in range(actuators):
                for part in range(2):
                    s0, s1 = drive[cell[p], a, part], drive[cell[p] + 1, a, part]
                    s2, s3 = drive[cell[p] + 2, a, part], drive[cell[p] + 3, a, part]
                    into = out[c, p, a, part]
                    for k in range(count):
                        into[k] = w0 * s0[k] + w1 * s1[k] + w2 * s2[k] + w3 * s3[k]
            for q in range(p, fingers):
                for k in range(count):
                    g[p, q, 0, k], g[p, q, 1, k] = 0.0, 0.0
                for i in range(4):
                    r0, r1 = _pair(cell[p] + i, cell[q], places), _pair(cell[p] + i, cell[q] + 1, places)
                    r2, r3 = _pair(cell[p] + i, cell[q] + 2, places), _pair(cell[p] + i, cell[q] + 3, places)
                    x0, x1 = weight[p, i] * weight[q, 0], weight[p, i] * weight[q, 1]
                    x2, x3 = weight[p, i] * weight[q, 2], weight[p, i] * weight[q, 3]
                    for part in range(2):
                        s0, s1, s2, s3 = point[r0, part], point[r1, part], point[r2, part], point[r3, part]
                        into = g[p, q, part]
                        for k in range(count):
                            into[k] += x0 * s0[k] + x1 * s1[k] + x2 * s2[k] + x3 * s3[k]
        # Attach the fingers one after another.
        for j in range(fingers):
            stiffness, damping, mass = impedance[c, j, 0], impedance[c, j, 1], impedance[c, j, 2]
            own_real, own_imag = g[j, j, 0], g[j, j, 1]
            # u + j v = z / (1 + z G_jj)
            for k in range(count):
                z_real, z_imag = stiffness - mass * omega[k] * omega[k], damping * omega[k]
                one_real = 1 + z_real * own_real[k] - z_imag * own_imag[k]
                one_imag = z_real * own_imag[k] + z_imag * own_real[k]
                scale = 1 / (one_real * one_real + one_imag * one_imag)
                u[k] = (z_real * one_real + z_imag * one_imag) * scale
                v[k] = (z_imag * one_real - z_real * one_imag) * scale
            for p in range(fingers):
                if p == j:
                    continue
                row_real, row_imag = g[min(p, j), max(p, j), 0], g[min(p, j), max(p, j), 1]
                for a in range(actuators):
                    _subtract_product(row_real, row_imag, u, v, out[c, j, a], out[c, p, a])
                # Later fingers need what they have with all others.
                for q in range(max(p, j + 1), fingers):
                    _subtract_product(row_real, row_imag, u, v, g[j, q], g[p, q])
            # Under the finger itself, last: G_jj u = 1 - 1 / (1 + z G_jj).
            for q in range(j + 1, fingers):
                _subtract_product(own_real, own_imag, u, v, g[j, q].copy(), g[j, q])
            for a in range(actuators):
                _subtract_product(own_real, own_imag, u, v, out[c, j, a].copy(), out[c, j, a])


@njit(types.void(_GIVEN, _PACKED), cache=True, fastmath=True)
def fill_powers(loaded, out):  # type: ignore[no-untyped-def]  # numba
    """Fill out (finger, part, frequency) with packed forms: the power under each finger, a mean over the cases.

    loaded (case, finger, actuator, 2, frequency). Parts: the diagonal, then real and imaginary part of every element
    above it, row by row.
    """
    cases, fingers, actuators, _, count = loaded.shape
    out[:] = 0.0
    for f in range(fingers):
        part = actuators
        for a in range(actuators):
            for c in range(cases):
                x, y, into = loaded[c, f, a, 0], loaded[c, f, a, 1], out[f, a]
                for k in range(count):
                    into[k] += np.float64(x[k]) * x[k] + np.float64(y[k]) * y[k]
            for b in range(a + 1, actuators):
                # conj(y_a) y_b
                real, imag = out[f, part], out[f, part + 1]
                for c in range(cases):
                    x, y = loaded[c, f, a, 0], loaded[c, f, a, 1]
                    s, t = loaded[c, f, b, 0], loaded[c, f, b, 1]
                    for k in range(count):
                        real[k] += np.float64(x[k]) * s[k] + np.float64(y[k]) * t[k]
                        imag[k] += np.float64(x[k]) * t[k] - np.float64(y[k]) * s[k]
                part += 2
    out /= cases


@njit(
    types.void(
        _FIELD, _BLOCK, _LINE, types.float64, _REAL, _BLOCK, _FIELD, types.Array(types.float64, 2, "C", readonly=True),
        _PACKED,
    ),
    cache=True,
    fastmath=True,
)  # fmt: skip
def fill_energies(drive, point, omega, pitch_m, position_m, impedance, loaded, share, out):  # type: ignore[no-untyped-def]  # numba
    """Fill out (stretch, part, frequency) with packed forms: kinetic energy over stretches of the bar, fingers on it.

    As `fill_loaded` for one case: position_m (finger,), impedance (1, finger, 3), loaded (finger, actuator, 2,
    frequency). share (stretch, place): how much of each place's power belongs to a stretch.
    """
    places, actuators, _, count = drive.shape
    fingers = len(position_m)
    force = np.empty((fingers, actuators, 2, count), dtype=np.float32)
    g, field = np.empty((2, count), dtype=np.float32), np.empty((actuators, 2, count), dtype=np.float32)
    cell, weight = np.empty(fingers, dtype=np.int64), np.empty((fingers, 4), dtype=np.float32)
    power = np.empty(count, dtype=np.float64)
    for p in range(fingers):
        cell[p] = _cubic(position_m[p] / pitch_m, places, weight[p])
        # The force of each finger on the bar is -z y.
        stiffness, damping, mass = impedance[0, p, 0], impedance[0, p, 1], impedance[0, p, 2]
        for a in range(actuators):
            for k in range(count):
                z_real, z_imag = stiffness - mass * omega[k] * omega[k], damping * omega[k]
                force[p, a, 0, k] = z_real * loaded[p, a, 0, k] - z_imag * loaded[p, a, 1, k]
                force[p, a, 1, k] = z_real * loaded[p, a, 1, k] + z_imag * loaded[p, a, 0, k]
    out[:] = 0.0
    for place in range(places):
        for a in range(actuators):
            for part in range(2):
                for k in range(count):
                    field[a, part, k] = drive[place, a, part, k]
        for p in range(fingers):
            g[:] = 0.0
            for i in range(4):
                row = point[_pair(place, cell[p] + i, places)]
                for part in range(2):
                    for k in range(count):
                        g[part, k] += weight[p, i] * row[part, k]
            for a in range(actuators):
                for k in range(count):
                    field[a, 0, k] -= g[0, k] * force[p, a, 0, k] - g[1, k] * force[p, a, 1, k]
                    field[a, 1, k] -= g[0, k] * force[p, a, 1, k] + g[1, k] * force[p, a, 0, k]
        # Add this place's power to the stretches that it belongs to.
        part = actuators
        for a in range(actuators):
            for k in range(count):
                power[k] = np.float64(field[a, 0, k]) * field[a, 0, k] + np.float64(field[a, 1, k]) * field[a, 1, k]
            _spread(power, share[:, place], out[:, a])
            for b in range(a + 1, actuators):
                for k in range(count):
                    power[k] = np.float64(field[a, 0, k]) * field[b, 0, k] + field[a, 1, k] * field[b, 1, k]
                _spread(power, share[:, place], out[:, part])
                for k in range(count):
                    power[k] = np.float64(field[a, 0, k]) * field[b, 1, k] - field[a, 1, k] * field[b, 0, k]
                _spread(power, share[:, place], out[:, part + 1])
                part += 2
