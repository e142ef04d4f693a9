"""A fit to what its data say of every parameter: covariance, confidence intervals, and combinations they leave open."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t

from precompute.calibration.fit import CAUCHY, SMALLEST_NOISE, Fit, refit_held
from precompute.calibration.misfit import Loss

Array = NDArray[np.float64]

CONFIDENCE = 0.95
_STRAIGHT = 0.05
"""Up to this standard deviation of a logarithm an interval follows from the curvature, beyond it from the cost."""
_PROBES = 12
_CLOSE = 0.02  # of the standard deviations at an interval's end
_RANK = 1e-14
_NOTHING = 1e-300


@dataclass(frozen=True)
class Certainty:
    """What the data say of the coordinates of the parameters.

    information (parameter, parameter): inverse of the covariance that the data alone would leave; curvature: second
    derivative of the cost, expected; prior (parameter,): standard deviation of what is known without them.
    """

    information: Array
    curvature: Array
    prior: Array
    freedom: int

    @property
    def quantile(self) -> float:
        """Of Student's t, two-sided."""
        return float(t.ppf((1 + CONFIDENCE) / 2, self.freedom))

    @cached_property
    def covariance(self) -> Array:
        """Shape (parameter, parameter): with the prior, without which what is not identifiable would have none."""
        return _inverse(self.information + np.diag(self.prior**-2.0))

    @cached_property
    def cost_ratio(self) -> Array:
        """Shape (parameter,): cost of a move by one standard deviation, the other parameters following; ideally 1/2."""
        bound = _inverse(self.curvature + np.diag(self.prior**-2.0))
        ratio: Array = 0.5 * np.diag(self.covariance) / np.diag(bound)
        return ratio


def compute_certainty(fit: Fit) -> Certainty:
    """For the loss that was minimised: sandwich covariances, so that outliers count."""
    information, curvature = _absolute(fit) if fit.loss is Loss.L1 else _squares(fit)
    prior = np.array([parameter.prior for parameter in fit.problem.misfit.parameters])
    data, parameters = fit.misfit.log_slope.shape
    return Certainty(information, curvature, prior, data - parameters)


def compute_intervals(fit: Fit, certainty: Certainty) -> Array:
    """Shape (parameter, 2): coordinates that the data do not contradict, within the bounds.

    Wide ones by the profile of the cost: where the likelihood is not a parabola, a standard error is no interval.
    """
    deviation = np.sqrt(np.diag(certainty.covariance))
    out = np.empty((len(deviation), 2))
    for i, (sd, value) in enumerate(zip(deviation, fit.coordinate, strict=True)):
        if sd <= _STRAIGHT:
            out[i] = value + certainty.quantile * sd * np.array([-1, 1])
        else:
            out[i] = [_profile_end(fit, certainty, i, sd, side) for side in (-1, 1)]
    return np.clip(out, fit.problem.low[:, None], fit.problem.high[:, None])


def _profile_end(fit: Fit, certainty: Certainty, index: int, deviation: float, side: int) -> float:
    """Where the cost, all other parameters refitted, has risen by what the quantile allows; or the bound."""
    value = float(fit.coordinate[index])
    bound = float((fit.problem.low if side < 0 else fit.problem.high)[index])
    reach = abs(bound - value)
    if reach <= 0:
        return bound
    inner, outer, follow = (0.0, 0.0), None, fit.coordinate
    tangent = certainty.covariance[index] / certainty.covariance[index, index]
    step = min(certainty.quantile * deviation, reach)
    for _ in range(_PROBES):
        guess = follow + (value + side * step - follow[index]) * tangent
        probe, cost = refit_held(fit, index, np.clip(guess, fit.problem.low, fit.problem.high))
        deviations = float(np.sqrt(max(cost - fit.cost, 0.0) / certainty.cost_ratio[index]))
        if deviations < certainty.quantile:
            if step >= reach:
                return bound
            inner, follow = (step, deviations), probe
        else:
            outer = (step, deviations)
        if abs(deviations - certainty.quantile) <= _CLOSE * certainty.quantile:
            break
        step = min(2 * step, reach) if outer is None else _between(inner, outer, certainty.quantile)
    return value + side * step


def _between(inner: tuple[float, float], outer: tuple[float, float], wanted: float) -> float:
    """A straight line between two (step, deviations), kept off its ends."""
    share = (wanted - inner[1]) / (outer[1] - inner[1])
    return inner[0] + min(max(share, 0.1), 0.9) * (outer[0] - inner[0])


def _squares(fit: Fit) -> tuple[Array, Array]:
    """Huber's covariance of an M-estimator: (J^T J)^-1 mean psi^2 / (mean psi')^2."""
    slope, u = fit.misfit.log_slope / fit.noise, fit.misfit.log_residual / fit.noise
    data, parameters = slope.shape
    weight = 1 / (1 + (u / CAUCHY) ** 2) if fit.loss is Loss.ROBUST else np.ones(data)
    bend = weight**2 * (1 - (u / CAUCHY) ** 2) if fit.loss is Loss.ROBUST else np.ones(data)
    spread = max(float(((weight * u) ** 2).sum()) / (data - parameters), (SMALLEST_NOISE / fit.noise) ** 2)
    gram, mean = slope.T @ slope, max(float(bend.mean()), 0.1)
    return gram * mean**2 / spread, gram * mean


def _absolute(fit: Fit) -> tuple[Array, Array]:
    """Of least absolute residuals: A S^-1 A with S = sum j j^T, A = sum 2 f(0) j j^T, noise in proportion to size.

    Columns are scaled to length 1 first: a parameter that does next to nothing would ruin the inverse.
    """
    mean_reading = fit.problem.misfit.mean_reading
    slope = fit.misfit.plain_slope / (fit.noise * mean_reading)
    data, parameters = slope.shape
    scale = np.maximum(np.linalg.norm(slope, axis=0), _NOTHING)
    unit, outer = slope / scale, np.outer(scale, scale)
    density = mean_reading / fit.misfit.size / np.sqrt(2 * np.pi)
    A = 2 * unit.T @ (unit * density[:, None])
    root, vector = np.linalg.eigh(unit.T @ unit)
    kept = root > _RANK * root[-1]
    half = (vector[:, kept] / np.sqrt(root[kept])).T @ A
    return half.T @ half * outer * (data - parameters) / data, A * outer


def _inverse(matrix: Array) -> Array:
    """Of a symmetric positive definite matrix whose columns differ by decades."""
    scale = np.sqrt(np.diag(matrix))
    inverse: Array = np.linalg.inv(matrix / np.outer(scale, scale)) / np.outer(scale, scale)
    symmetric: Array = (inverse + inverse.T) / 2
    return symmetric
