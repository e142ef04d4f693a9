"""Misfit of measurements, and its minimum: global screening, then a local minimisation with a robust loss.

The misfit has many local minima, because a resonance that is fitted to the wrong peak cannot move past the right one.
So a fit starts from several places: the device's own values, and the most promising of 64 points of a Latin hypercube
within the bounds. Each is minimised with a soft loss at a coarse noise of 10 %, which sees far; while the median
residual of the best stays above that noise its basin is doubtful, and up to four times as many places are tried.

Near the best place the loss and the noise are settled in turn: the noise is a robust estimate (median absolute
deviation) of the residuals, the robust loss (Cauchy) is scaled by it, and the minimum is refitted until the noise
stays.

All parameters are minimised in coordinates (logarithms; asinh for dampings that may be 0), so bounds of several decades
are no trouble. A weak tie to the start, three widths of the bounds wide, keeps a parameter in place that no reading
depends on; its effect on a known parameter is negligible.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from scipy.optimize import least_squares

from base.arrays import Array, Complex, Mask
from precompute.measurements.model import MeasurementModel
from precompute.measurements.parameters import Parameter, rates_at, values_at
from precompute.measurements.types import Kind, Measurements
from precompute.sampling.plants import latin_hypercube


@dataclass(frozen=True)
class Misfit:
    """Residuals (datum,), predicted minus measured, and their derivatives (datum, parameter) by the coordinates.

    log_: of logarithms of accelerations, a response's phase in radians. A peak is one datum, a response two, all real
    parts before all imaginary ones.
    """

    log_residual: Array
    log_slope: Array


class MisfitModel:
    """The misfit of measurements as a function of the coordinates of parameters (parameter,)."""

    def __init__(self, model: MeasurementModel, measurements: Measurements, parameters: tuple[Parameter, ...]) -> None:
        self._model, self.is_peak = model, measurements.kind is Kind.PEAK
        self._log_measured = np.log(measurements.acceleration)
        self._last: tuple[Array, Misfit] | None = None
        self.parameters, self.least_noise = parameters, 1e-8  # below which residuals are rounding errors of the model

    def at(self, coordinate: Array) -> Misfit:
        """The misfit at a coordinate; the last one is remembered."""
        if self._last is None or not np.array_equal(self._last[0], coordinate):
            self._last = (coordinate.copy(), self._compute(coordinate))
        return self._last[1]

    def _compute(self, coordinate: Array) -> Misfit:
        prediction = self._model.predict(values_at(self.parameters, coordinate))
        slope = prediction.by_parameter * rates_at(self.parameters, coordinate)
        difference = prediction.log_acceleration - self._log_measured
        turned = difference.real + 1j * ((difference.imag + np.pi) % (2 * np.pi) - np.pi)  # phases within half a turn
        return Misfit(log_residual=self._data(turned), log_slope=self._data(slope))

    def _data(self, value: Complex) -> Array:
        """Data along the first axis from the rows."""
        real: Array = value.real
        return real.copy() if self.is_peak else np.concatenate([real, value.imag])


Rho = Callable[[Array], Array]

CAUCHY = 2.385
"""Scale of the Cauchy loss in standard deviations: 95 % of the efficiency of least squares under normal noise."""
_NORMAL_MAD = 1.4826  # standard deviation of normal noise over its median absolute deviation
_COARSE_NOISE = 0.1  # relative noise that the screening assumes
_TIE = 3.0  # widths of the bounds
_SCREENED, _PATIENCE = 64, 4  # places screened; times as many starts while the basin is doubtful
_NEAR = 1e-6  # of the width of the bounds
_ROUNDS = 15
_SETTLED = 0.02  # of the noise: its own error is more; fits of the tests take 3 rounds at most, also with 0.2
_TOLERANCE = 1e-13  # of the cost; 1e-9 passes the tests of fits too
_ROUGH = 1e-5  # of the cost: a hundredth of a standard deviation


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


def fit(problem: Problem, starts: int, seed: int) -> Fit:
    """Minimise from the device's values and the `starts` - 1 best places of a seeded screening."""
    places = [problem.start, *_screen(problem, _PATIENCE * starts - 1, seed)] if starts > 1 else [problem.start]
    first, least = problem.start, np.inf
    for tried, place in enumerate(places):
        if tried >= starts and _noise(problem, first) <= _COARSE_NOISE:
            break
        value, cost = _minimise_squares(problem, _soft, _COARSE_NOISE, place, _ROUGH)
        if cost < least:
            first, least = value, cost
    return settle(problem, first)


def settle(problem: Problem, first: Array) -> Fit:
    """Minimise near `first`, parameters and noise in turn, until the noise stays."""
    value, noise = first, max(_noise(problem, first), problem.misfit.least_noise)
    for _ in range(_ROUNDS):
        value, cost = minimise(problem, noise, value)
        last, noise = noise, max(_noise(problem, value), problem.misfit.least_noise)
        if abs(noise - last) <= _SETTLED * last:
            break
    value, cost = minimise(problem, noise, value)
    return Fit(problem, _snapped(problem, value), cost, noise)


def _snapped(problem: Problem, value: Array) -> Array:
    """Coordinates moved onto a bound where the interior method stopped just beside it."""
    near = _NEAR * (problem.high - problem.low)
    low, high = problem.low, problem.high
    return np.where(value - low <= near, low, np.where(high - value <= near, high, value))


def minimise(problem: Problem, noise: float, first: Array, tolerance: float = _TOLERANCE) -> tuple[Array, float]:
    """The minimum near `first`: coordinates and cost, to the relative `tolerance` of the cost."""
    return _minimise_squares(problem, _cauchy, noise, first, tolerance)


def refit_held(fit: Fit, index: int, first: Array) -> tuple[Array, float]:
    """A rough minimum with one parameter held where it is in `first` and the noise unchanged."""
    free = fit.problem.free.copy()
    free[index] = False
    return minimise(replace(fit.problem, free=free), fit.noise, first, _ROUGH)


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
