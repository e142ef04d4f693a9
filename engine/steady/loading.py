"""Kernels that put fingers on the surface: responses under fingers at any positions, and the forms of their powers.

Functions are interpolated between places by cubics, and receptances are sums over them; fingers are attached one after
another, each as a rank-one update (Sherman and Morrison). Frequencies are the innermost axis, real and imaginary parts
apart, so that all loops become vector instructions. Single precision is enough: the deepest minimum under a finger is
1/1000 of the motion.
"""

import numpy as np
from numba import types

from base.compiled import njit

_ROWS = types.Array(types.float32, 2, "C", readonly=True)
_BLOCK = types.Array(types.float32, 3, "C", readonly=True)
_FIELD = types.Array(types.float32, 4, "C", readonly=True)
_LINE = types.Array(types.float32, 1, "C", readonly=True)
_REAL = types.Array(types.float64, 1, "C", readonly=True)
_REALS = types.Array(types.float64, 2, "C", readonly=True)
_SPACE = types.Array(types.float32, 4, "C")
_LOADED = types.Array(types.float32, 5, "C")
_GIVEN = types.Array(types.float32, 5, "C", readonly=True)
_PACKED = types.Array(types.float64, 3, "C")


@njit(cache=True)
def _cubic(at, count, weight):  # type: ignore[no-untyped-def]  # numba
    """Fill weight (4,) of the cubic through four places about `at`, in steps; return their first and their number.

    Of a side with one place, as a bar has across, that place has all the weight.
    """
    if count < 4:
        weight[0] = 1.0
        return 0, 1
    first = min(max(int(at) - 1, 0), count - 4)
    x = at - first
    weight[0] = -(x - 1) * (x - 2) * (x - 3) / 6
    weight[1] = x * (x - 2) * (x - 3) / 2
    weight[2] = -x * (x - 1) * (x - 3) / 2
    weight[3] = x * (x - 1) * (x - 2) / 6
    return first, 4


@njit(types.void(_REAL, _REAL, _BLOCK, types.Array(types.float32, 2, "C")), cache=True)
def fill_shapes(along, across, grid, out):  # type: ignore[no-untyped-def]  # numba
    """Fill out (point, function) at coordinates (point,) in steps of the grid. grid (across, along, function)."""
    x, y = np.empty(4), np.empty(4)
    out[:] = 0.0
    for point in range(len(along)):
        column, columns = _cubic(along[point], grid.shape[1], x)
        row, rows = _cubic(across[point], grid.shape[0], y)
        for j in range(rows):
            for i in range(columns):
                weight, values = np.float32(y[j] * x[i]), grid[row + j, column + i]
                for k in range(len(values)):
                    out[point, k] += weight * values[k]


@njit(fastmath=True)
def _fill_sum(weight, table, out):  # type: ignore[no-untyped-def]  # numba
    """Fill out (k,) with weight (i,) @ table (i, k), four rows at a time."""
    for k in range(len(out)):
        out[k] = 0.0
    four = len(weight) // 4 * 4
    for i in range(0, four, 4):
        w0, w1, w2, w3 = weight[i], weight[i + 1], weight[i + 2], weight[i + 3]
        s0, s1, s2, s3 = table[i], table[i + 1], table[i + 2], table[i + 3]
        for k in range(len(out)):
            out[k] += w0 * s0[k] + w1 * s1[k] + w2 * s2[k] + w3 * s3[k]
    for i in range(four, len(weight)):
        w0, s0 = weight[i], table[i]
        for k in range(len(out)):
            out[k] += w0 * s0[k]


@njit(fastmath=True)
def _fill_receptance(one, other, spread, line, product, out):  # type: ignore[no-untyped-def]  # numba
    """Fill out (2 frequency,) with the receptance between two points, from their mode shapes (mode,), without dampers.

    spread (mode, line), line (line, 2 frequency); product (line,): space.
    """
    product[:] = 0.0
    for m in range(len(one)):
        weight, row = one[m] * other[m], spread[m]
        for k in range(len(row)):
            product[k] += weight * row[k]
    _fill_sum(product, line, out)


@njit(fastmath=True, inline="always")
def _subtract_square(one, other, out):  # type: ignore[no-untyped-def]  # numba
    """Subtract the product of two complex rows (2, frequency) from out (2, frequency), elementwise."""
    x, y, u, v, real, imag = one[0], one[1], other[0], other[1], out[0], out[1]
    for k in range(len(x)):
        real[k] -= x[k] * u[k] - y[k] * v[k]
    for k in range(len(x)):
        imag[k] -= x[k] * v[k] + y[k] * u[k]


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
    types.void(_BLOCK, _BLOCK, _ROWS, _ROWS, _ROWS, _ROWS, _LINE, _BLOCK, _SPACE, _SPACE, _SPACE,
               _LOADED),
    cache=True,
    fastmath=True,
)  # fmt: skip
def fill_loaded(shape, span, drive, damper, spread, line, omega, impedance, nodes, t, g, out):  # type: ignore[no-untyped-def]  # numba
    """Fill out (case, finger, actuator, 2, frequency) with the response under each finger, all fingers on the surface.

    shape (case, finger, function): functions of the drive, then modes; span (finger, case, node): the cases' shapes lie
    in the span of these orthonormal ones. drive, damper (function, actuator 2 frequency): drives in any unit, and what
    the mounts' dampers take. spread (mode, line), line (line, 2 frequency): receptances of modes. omega (frequency,),
    1/s; impedance (case, finger, 3): stiffness, damping, mass. Space: nodes (2, finger, node, actuator 2 frequency),
    t (finger, actuator, 2, frequency), g (finger, finger, 2, frequency).
    """
    functions, width = drive.shape
    cases, fingers, actuators, _, count = out.shape
    weight, product = np.empty(functions, dtype=np.float32), np.empty(spread.shape[1], dtype=np.float32)
    u, v = np.empty(count, dtype=np.float32), np.empty(count, dtype=np.float32)
    # Cases differ by a millimetre: what moves is summed over functions at a few nodes, and between them for each case.
    for p in range(fingers):
        for node in range(span.shape[2]):
            weight[:] = 0.0
            for c in range(cases):
                for k in range(functions):
                    weight[k] += span[p, c, node] * shape[c, p, k]
            _fill_sum(weight, drive, nodes[0, p, node])
            _fill_sum(weight, damper, nodes[1, p, node])
    for c in range(cases):
        for p in range(fingers):
            _fill_sum(span[p, c], nodes[0, p], out[c, p].reshape(width))
            _fill_sum(span[p, c], nodes[1, p], t[p].reshape(width))
        # Receptances between fingers (upper triangle) of the untouched surface.
        for p in range(fingers):
            for q in range(p, fingers):
                one, other = shape[c, p, functions:], shape[c, q, functions:]
                _fill_receptance(one, other, spread, line, product, g[p, q].reshape(2 * count))
                for a in range(actuators):
                    _subtract_square(t[p, a], t[q, a], g[p, q])
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
    types.void(_FIELD, _FIELD, _ROWS, _ROWS, _ROWS, _ROWS, _ROWS, _LINE, _BLOCK, _FIELD, _REALS, _PACKED),
    cache=True,
    fastmath=True,
)
def fill_energies(drive, taken, at, shape, damper, spread, line, omega, impedance, loaded, share, out):  # type: ignore[no-untyped-def]  # numba
    """Fill out (stretch, part, frequency) with packed forms: kinetic energy of stretches of the surface, fingers on it.

    drive, taken (point, actuator, 2, frequency): of the untouched surface at the points of an integral, what `drive`
    and `damper` of `fill_loaded` give there; at (point, mode). As there for one case: shape (finger, function),
    impedance (1, finger, 3), loaded (finger, actuator, 2, frequency). share (stretch, point): weights of the integrals.
    """
    points, actuators, _, count = drive.shape
    fingers, functions = len(shape), len(damper)
    force = np.empty((fingers, actuators, 2, count), dtype=np.float32)
    t = np.empty((fingers, actuators, 2, count), dtype=np.float32)
    g, field = np.empty((2, count), dtype=np.float32), np.empty((actuators, 2, count), dtype=np.float32)
    product, power = np.empty(spread.shape[1], dtype=np.float32), np.empty(count, dtype=np.float64)
    for p in range(fingers):
        _fill_sum(shape[p, :functions], damper, t[p].reshape(actuators * 2 * count))
        # The force of each finger on the surface is -z y.
        stiffness, damping, mass = impedance[0, p, 0], impedance[0, p, 1], impedance[0, p, 2]
        for a in range(actuators):
            for k in range(count):
                z_real, z_imag = stiffness - mass * omega[k] * omega[k], damping * omega[k]
                force[p, a, 0, k] = z_real * loaded[p, a, 0, k] - z_imag * loaded[p, a, 1, k]
                force[p, a, 1, k] = z_real * loaded[p, a, 1, k] + z_imag * loaded[p, a, 0, k]
    out[:] = 0.0
    for point in range(points):
        if not share[:, point].any():
            continue
        for a in range(actuators):
            for part in range(2):
                for k in range(count):
                    field[a, part, k] = drive[point, a, part, k]
        for p in range(fingers):
            _fill_receptance(at[point], shape[p, functions:], spread, line, product, g.reshape(2 * count))
            for a in range(actuators):
                _subtract_square(taken[point, a], t[p, a], g)
            for a in range(actuators):
                _subtract_square(g, force[p, a], field[a])
        # Add this point's power to the stretches that it belongs to.
        part = actuators
        for a in range(actuators):
            for k in range(count):
                power[k] = np.float64(field[a, 0, k]) * field[a, 0, k] + np.float64(field[a, 1, k]) * field[a, 1, k]
            _spread(power, share[:, point], out[:, a])
            for b in range(a + 1, actuators):
                for k in range(count):
                    power[k] = np.float64(field[a, 0, k]) * field[b, 0, k] + field[a, 1, k] * field[b, 1, k]
                _spread(power, share[:, point], out[:, part])
                for k in range(count):
                    power[k] = np.float64(field[a, 0, k]) * field[b, 1, k] - field[a, 1, k] * field[b, 0, k]
                _spread(power, share[:, point], out[:, part + 1])
                part += 2
