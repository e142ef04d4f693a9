"""Least absolute residuals (paper eq. (12)) by a sequence of linear programs in a trust region."""

from collections.abc import Callable

import numpy as np
from scipy.optimize import linprog

from base.arrays import Array

Linearised = Callable[[Array], tuple[Array, Array]]

_FIRST_STEP = 0.1  # of a natural logarithm
_LONGEST_STEP = 1.0
_SHORTEST_STEP = 1e-13  # of a natural logarithm: some hundred roundings; no shorter step changes a value
_ITERATIONS = 60  # fits of the tests take 25 at most; against a loop that gains nothing
_NOTHING = 1e-300  # against division by 0


def solve_least_absolute(linearised: Linearised, start: Array, low: Array, high: Array, tolerance: float) -> Array:
    """The point (parameter,) near `start` within the bounds that minimises the sum of |residual|.

    `linearised` gives residuals (datum,) and their derivatives (datum, parameter). At the minimum one residual for each
    parameter is 0, so the steps converge quadratically, as Newton's. The iteration ends when a step promises less than
    `tolerance` of the sum.
    """
    point, step = start, _FIRST_STEP
    residual, slope = linearised(point)
    cost = float(np.abs(residual).sum())
    for _ in range(_ITERATIONS):
        move = _solve_program(residual, slope, np.maximum(low - point, -step), np.minimum(high - point, step))
        promised = cost - float(np.abs(residual + slope @ move).sum())
        if promised <= tolerance * cost or step < _SHORTEST_STEP:
            break
        candidate = np.clip(point + move, low, high)
        there = linearised(candidate)
        kept = (cost - float(np.abs(there[0]).sum())) / promised
        if kept > 0:
            point, (residual, slope) = candidate, there
            cost = float(np.abs(residual).sum())
        step = min(2 * step, _LONGEST_STEP) if kept > 0.75 else step if kept > 0.25 else step / 4
    return point


def _solve_program(residual: Array, slope: Array, low: Array, high: Array) -> Array:
    """The move within bounds that minimises sum |residual + slope move|, read from the multipliers of the dual program.

    maximise residual^T u + low^T v - high^T w, |u| <= 1, v, w >= 0, slope^T u = v - w. The dual has a row for each
    parameter, the primal one for each datum.
    """
    data, parameters = slope.shape
    scale = np.maximum(np.abs(slope).max(axis=0), _NOTHING)
    size = max(float(np.abs(residual).max()), _NOTHING)
    program = linprog(
        -np.concatenate([residual / size, low * scale / size, -high * scale / size]),
        A_eq=np.hstack([(slope / scale).T, -np.eye(parameters), np.eye(parameters)]),
        b_eq=np.zeros(parameters),
        bounds=[(-1.0, 1.0)] * data + [(0.0, None)] * (2 * parameters),
        method="highs-ds",
    )
    if program.x is None:
        return np.zeros(parameters)
    move: Array = np.clip(program.eqlin.marginals * size / scale, low, high)
    return move
