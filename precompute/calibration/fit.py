"""Fit of the parameters to measurements: global screening, then a local minimisation of the chosen loss.

The misfit has many local minima, because a resonance that is fitted to the wrong peak cannot move past the right one.
So a fit starts from several places: the device's own values, and the most promising of 64 points of a Latin hypercube
within the bounds. Each is minimised with a soft loss at a coarse noise of 10 %, which sees far; while the median
residual of the best stays above that noise its basin is doubtful, and up to four times as many places are tried.

Near the best place the loss and the noise are settled in turn: the noise is a robust estimate (median absolute
deviation) of the residuals, the robust loss (Cauchy) is scaled by it, and the minimum is refitted until the noise
stays. Plain least squares and the paper's sum of absolute differences (12) start from the robust minimum; the sum is
minimised by a sequence of linear programs in a trust region.

All parameters are minimised in coordinates (logarithms; asinh for dampings that may be 0), so bounds of several decades
are no trouble. A weak tie to the start, three widths of the bounds wide, keeps a parameter in place that no reading
depends on; its effect on a known parameter is negligible.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from scipy.optimize import least_squares, linprog

from base.arrays import Array, Mask
from precompute.calibration.misfit import Loss, Misfit, MisfitModel
from precompute.sampling.plants import latin_hypercube

Rho = Callable[[Array], Array]

CAUCHY = 2.385
"""Scale of the Cauchy loss in standard deviations: 95 % of the efficiency of least squares under normal noise."""
_NORMAL_MAD = 1.4826  # standard deviation of normal noise over its median absolute deviation
_COARSE_NOISE = 0.1  # relative noise that the screening assumes
_TIE = 3.0  # widths of the bounds
_SCREENED, _PATIENCE = 64, 4  # places screened; times as many starts while the basin is doubtful
_NEAR = 1e-6  # of the width of the bounds
_ROUNDS, _ROUNDS_L1 = 15, 2  # the sum of absolute residuals needs the noise for its tie only
_SETTLED = 0.02  # of the noise: its own error is more; fits of the tests take 3 rounds at most, also with 0.2
_TOLERANCE = 1e-13  # of the cost; 1e-9 passes the tests of fits too
_LEAST_PROMISE = 1e-10  # of the cost: the rounding of the linear programs
_ROUGH = 1e-5  # of the cost: a hundredth of a standard deviation
Linearised = Callable[[Array], tuple[Array, Array]]

_FIRST_STEP = 0.1  # of a natural logarithm
_LONGEST_STEP = 1.0
_SHORTEST_STEP = 1e-13  # of a natural logarithm: some hundred roundings; no shorter step changes a value
_ITERATIONS = 60  # fits of the tests take 25 at most; against a loop that gains nothing
_NOTHING = 1e-300  # against division by 0


@dataclass(frozen=True)
class Problem:
    """A misfit to be minimised within bounds; start, low, high (parameter,) are coordinates.

    free (parameter,): whether a parameter may move; the others stay where they are.
    """

    misfit: MisfitModel
    start: Array
    low: Array
    high: Array
    free: Mask

    @property
    def tie(self) -> Array:
        """Standard deviation (parameter,) of the tie to `start`."""
        return _TIE * (self.high - self.low)

    def whole(self, free_value: Array, about: Array) -> Array:
        """All coordinates from the free ones, with the others as in `about`."""
        out = about.copy()
        out[self.free] = free_value
        return out


@dataclass(frozen=True)
class Fit:
    """The minimum of a problem: coordinate (parameter,), cost, and relative standard deviation of the noise."""

    problem: Problem
    loss: Loss
    coordinate: Array
    cost: float
    noise: float

    @property
    def misfit(self) -> Misfit:
        """The misfit at the minimum."""
        return self.problem.misfit.at(self.coordinate)


def pose(misfit: MisfitModel) -> Problem:
    """The problem of all parameters of a misfit, within their bounds."""
    ends = np.array([[p.coordinate(value) for value in (p.start, p.low, p.high)] for p in misfit.parameters])
    start, low, high = ends.T
    return Problem(misfit, start, low, high, np.ones(len(start), dtype=np.bool_))


def fit(problem: Problem, loss: Loss, starts: int, seed: int) -> Fit:
    """Minimise `loss` from the device's values and the `starts` - 1 best places of a seeded screening."""
    places = [problem.start, *_screen(problem, _PATIENCE * starts - 1, seed)] if starts > 1 else [problem.start]
    first, least = problem.start, np.inf
    for tried, place in enumerate(places):
        if tried >= starts and _noise(problem, first) <= _COARSE_NOISE:
            break
        value, cost = _minimise_squares(problem, _soft, _COARSE_NOISE, place, _ROUGH)
        if cost < least:
            first, least = value, cost
    robust = settle(problem, Loss.ROBUST, first)
    return robust if loss is Loss.ROBUST else settle(problem, loss, robust.coordinate)


def settle(problem: Problem, loss: Loss, first: Array) -> Fit:
    """Minimise near `first`, parameters and noise in turn, until the noise stays."""
    value, noise = first, max(_noise(problem, first), problem.misfit.least_noise)
    for _ in range(_ROUNDS_L1 if loss is Loss.L1 else _ROUNDS):
        value, cost = minimise(problem, loss, noise, value)
        last, noise = noise, max(_noise(problem, value), problem.misfit.least_noise)
        if abs(noise - last) <= _SETTLED * last:
            break
    value, cost = minimise(problem, loss, noise, value)
    return Fit(problem, loss, _snapped(problem, value), cost, noise)


def _snapped(problem: Problem, value: Array) -> Array:
    """Coordinates moved onto a bound where the interior method stopped just beside it."""
    near = _NEAR * (problem.high - problem.low)
    low, high = problem.low, problem.high
    return np.where(value - low <= near, low, np.where(high - value <= near, high, value))


def minimise(
    problem: Problem, loss: Loss, noise: float, first: Array, tolerance: float = _TOLERANCE
) -> tuple[Array, float]:
    """The minimum near `first`: coordinates and cost, to the relative `tolerance` of the cost."""
    if loss is Loss.L1:
        return _minimise_absolute(problem, noise, first, tolerance)
    return _minimise_squares(problem, _cauchy if loss is Loss.ROBUST else _plain, noise, first, tolerance)


def refit_held(fit: Fit, index: int, first: Array) -> tuple[Array, float]:
    """A rough minimum with one parameter held where it is in `first` and the noise unchanged."""
    free = fit.problem.free.copy()
    free[index] = False
    return minimise(replace(fit.problem, free=free), fit.loss, fit.noise, first, _ROUGH)


def _screen(problem: Problem, count: int, seed: int) -> list[Array]:
    """The places of a Latin hypercube with the least misfit; dampings, whose bounds span decades, stay at the start."""
    spread = latin_hypercube(_SCREENED, len(problem.start), np.random.default_rng(seed))
    places = np.tile(problem.start, (_SCREENED, 1))
    for i, parameter in enumerate(problem.misfit.parameters):
        if not parameter.is_damping:
            places[:, i] = problem.low[i] + (problem.high[i] - problem.low[i]) * spread[:, i]
    costs = [float(_soft((problem.misfit.at(p).log_residual / _COARSE_NOISE) ** 2)[0].sum()) for p in places]
    return [places[i] for i in np.argsort(costs)[:count]]


def _noise(problem: Problem, value: Array) -> float:
    """Robust relative standard deviation of the residuals, without the few that a fit may have nulled."""
    size = np.sort(np.abs(problem.misfit.at(value).log_residual))
    return _NORMAL_MAD * float(np.median(size[int(problem.free.sum()) :])) if len(size) > problem.free.sum() else 0.0


def _plain(z: Array) -> Array:
    return np.stack([z, np.ones_like(z), np.zeros_like(z)])


def _soft(z: Array) -> Array:
    root = np.sqrt(1 + z)
    return np.stack([2 * (root - 1), 1 / root, -0.5 / root**3])


def _cauchy(z: Array) -> Array:
    weight = 1 / (1 + z / CAUCHY**2)
    return np.stack([-(CAUCHY**2) * np.log(weight), weight, -(weight**2) / CAUCHY**2])


def _minimise_squares(problem: Problem, rho: Rho, noise: float, first: Array, tolerance: float) -> tuple[Array, float]:
    """Minimise half of the sum of rho((residual / noise)^2) and of the squared ties."""
    free, ties = problem.free, len(problem.start)

    def tied(z: Array) -> Array:
        return np.concatenate([rho(z[:-ties]), _plain(z[-ties:])], axis=1)

    def residual(x: Array) -> Array:
        value = problem.whole(x, first)
        return np.concatenate([problem.misfit.at(value).log_residual / noise, (value - problem.start) / problem.tie])

    def slope(x: Array) -> Array:
        jacobian = problem.misfit.at(problem.whole(x, first)).log_slope[:, free] / noise
        return np.concatenate([jacobian, np.diag(1 / problem.tie)[:, free]])

    low, high = problem.low[free], problem.high[free]
    inside = np.clip(first[free], low + 1e-6 * (high - low), high - 1e-6 * (high - low))
    found = least_squares(
        residual,
        inside,
        slope,
        (low, high),
        loss=cast("Any", tied),  # the stub's is not SciPy's: rho(z), shape (3, datum)
        xtol=tolerance,
        ftol=tolerance,
        gtol=tolerance,
        max_nfev=200,
    )
    return problem.whole(found.x, first), float(found.cost)


def _minimise_absolute(problem: Problem, noise: float, first: Array, tolerance: float) -> tuple[Array, float]:
    """Minimise the sum of |residual| in units of the noise of a mean reading, and of |ties|."""
    free, unit = problem.free, noise * problem.misfit.mean_reading

    def linearised(x: Array) -> tuple[Array, Array]:
        value = problem.whole(x, first)
        misfit = problem.misfit.at(value)
        tie = np.sqrt(2) / problem.tie
        residual = np.concatenate([misfit.plain_residual / unit, tie * (value - problem.start)])
        return residual, np.concatenate([misfit.plain_slope[:, free] / unit, np.diag(tie)[:, free]])

    found = solve_least_absolute(
        linearised, first[free], problem.low[free], problem.high[free], max(tolerance, _LEAST_PROMISE)
    )
    return problem.whole(found, first), float(np.abs(linearised(found)[0]).sum())


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
