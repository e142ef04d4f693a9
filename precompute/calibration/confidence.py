"""Covariance and confidence intervals of a fit.

The covariance is the sandwich estimate for the robust loss: the inverse of the curvature of the cost around
the scatter of its gradient. Outliers and the shape of the loss count in it, which an inverse Hessian alone would
ignore. It includes a prior, uniform within the bounds of each parameter; without it a parameter that the data leave
open would have no finite variance.

Complex responses differ in quality, by a hundred where a reading beside a node hardly stands out of the noise, and the
real and the imaginary part of one go wrong together. So for them the scatter of the gradient is summed reading by
reading (White, Econometrica 48, 1980, with the leverages of HC3). A few readings may then carry a parameter, and their
scatter is known as badly as few readings know it: Student's degrees of freedom are those of the parameter that has the
fewest (Satterthwaite). `tests/studies/physics/uneven_readings.py` has the share of intervals that hold, for this and
for errors that are taken as even, as they still are for peaks.

Where a parameter is known to 5 % or better the cost is nearly a parabola, and its interval is the value plus and minus
Student's quantile times the standard error. Beyond, the interval is the profile of the cost: the parameter is moved and
held, all others are refitted, until the cost has risen by what the quantile allows. Profiles cost some refits, but hold
for one-sided cases too (a damping "at most 0.1"), where a standard error describes nothing.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import stdtrit

from base.arrays import Array
from precompute.calibration.fit import CAUCHY, Fit, refit_held

CONFIDENCE = 0.95  # the custom of the field; docs/calibration-coverage.png shows that it is kept
_NEARLY_LINEAR = 0.05
"""Standard deviation of a logarithm up to which an interval follows from the curvature."""
_PROBES = 12  # intervals of its tests take 6 at most; against a loop that comes no closer
_CLOSE = 0.02  # of the standard deviations at an interval's end
_RANK = 1e-14  # 45 roundings: what is smaller, beside the greatest, is no information
_NOTHING = 1e-300  # against division by 0, where no reading depends on a parameter
_FEWEST = 3
"""Degrees of freedom at the least."""
_LEAST_FREEDOM = 0.1
"""A reading that alone determines a parameter says nothing of its own error; its residual counts ten times at most."""


@dataclass(frozen=True)
class Confidence:
    """Precision with which the data determine the coordinates of the parameters.

    information (parameter, parameter): inverse of the covariance that the data alone would leave. curvature: expected
    second derivative of the cost. prior (parameter,): standard deviation before the measurement. freedom: degrees of
    freedom of Student's distribution.
    """

    information: Array
    curvature: Array
    prior: Array
    freedom: int

    @property
    def quantile(self) -> float:
        """Two-sided quantile of Student's t at CONFIDENCE."""
        return float(stdtrit(self.freedom, (1 + CONFIDENCE) / 2))

    @cached_property
    def covariance(self) -> Array:
        """Covariance (parameter, parameter) with the prior."""
        return _inverse(self.information + np.diag(self.prior**-2.0))

    @cached_property
    def cost_ratio(self) -> Array:
        """Rise of the cost (parameter,) at one standard deviation, the others refitted; 1/2 for normal noise."""
        bound = _inverse(self.curvature + np.diag(self.prior**-2.0))
        ratio: Array = 0.5 * np.diag(self.covariance) / np.diag(bound)
        return ratio


def compute_confidence(fit: Fit) -> Confidence:
    """Confidence in a fit, by the sandwich covariance for the robust loss."""
    data, parameters = fit.misfit.log_slope.shape
    information, curvature, *fewer = _information(fit)
    prior = np.array([parameter.prior for parameter in fit.problem.misfit.parameters])
    return Confidence(information, curvature, prior, min([max(data - parameters, 1), *fewer]))


def compute_intervals(fit: Fit, confidence: Confidence) -> Array:
    """Ends (parameter, 2) of the intervals of the coordinates within the bounds; wide ones by the profile."""
    deviation = np.sqrt(np.diag(confidence.covariance))
    out = np.empty((len(deviation), 2))
    for i, (sd, value) in enumerate(zip(deviation, fit.coordinate, strict=True)):
        if sd <= _NEARLY_LINEAR:
            out[i] = value + confidence.quantile * sd * np.array([-1, 1])
        else:
            out[i] = [_profile_end(fit, confidence, i, sd, side) for side in (-1, 1)]
    return np.clip(out, fit.problem.low[:, None], fit.problem.high[:, None])


def _profile_end(fit: Fit, confidence: Confidence, index: int, deviation: float, side: int) -> float:
    """Coordinate at which the profile of the cost has risen by what the quantile allows, or the bound."""
    value = float(fit.coordinate[index])
    bound = float((fit.problem.low if side < 0 else fit.problem.high)[index])
    reach = abs(bound - value)
    if reach <= 0:
        return bound
    inner, outer, follow = (0.0, 0.0), None, fit.coordinate
    tangent = confidence.covariance[index] / confidence.covariance[index, index]
    step = min(confidence.quantile * deviation, reach)
    for _ in range(_PROBES):
        guess = follow + (value + side * step - follow[index]) * tangent
        probe, cost = refit_held(fit, index, np.clip(guess, fit.problem.low, fit.problem.high))
        deviations = float(np.sqrt(max(cost - fit.cost, 0.0) / confidence.cost_ratio[index]))
        if deviations < confidence.quantile:
            if step >= reach:
                return bound
            inner, follow = (step, deviations), probe
        else:
            outer = (step, deviations)
        if abs(deviations - confidence.quantile) <= _CLOSE * confidence.quantile:
            break
        step = min(2 * step, reach) if outer is None else _between(inner, outer, confidence.quantile)
    return value + side * step


def _between(inner: tuple[float, float], outer: tuple[float, float], wanted: float) -> float:
    """Secant step between two (step, deviations), kept away from both ends."""
    share = (wanted - inner[1]) / (outer[1] - inner[1])
    return inner[0] + min(max(share, 0.1), 0.9) * (outer[0] - inner[0])


def _information(fit: Fit) -> tuple[Array, Array] | tuple[Array, Array, int]:
    """Huber's covariance of an M-estimator: (J^T J)^-1 mean psi^2 / (mean psi')^2; of responses, reading by reading."""
    slope, u = fit.misfit.log_slope / fit.noise, fit.misfit.log_residual / fit.noise
    data, parameters = slope.shape
    weight = 1 / (1 + (u / CAUCHY) ** 2)
    bend = weight**2 * (1 - (u / CAUCHY) ** 2)
    least = (fit.problem.misfit.least_noise / fit.noise) ** 2
    spread = max(float(((weight * u) ** 2).sum()) / max(data - parameters, 1), least)
    gram, mean = slope.T @ slope, max(float(bend.mean()), 0.1)
    if not fit.problem.misfit.is_peak:
        information, freedom = _by_reading(slope, weight * u, least)
        return information * mean**2, gram * mean, freedom
    return gram * mean**2 / spread, gram * mean


def _by_reading(slope: Array, gradient: Array, least: float) -> tuple[Array, int]:
    """Information A B^-1 A of uneven readings, and degrees of freedom.

    A = J^T J, and B is the sum over the readings of their own squared gradients.

    slope (datum, parameter) and gradient (datum,), psi: all real parts before all imaginary ones.
    least: square of the noise that a reading has at the least, in units of that of the fit.
    """
    # Columns differ by decades; a parameter without effect would spoil the inverse.
    scale = np.maximum(np.linalg.norm(slope, axis=0), _NOTHING)
    unit = slope / scale
    A = unit.T @ unit
    leverage = np.einsum("ij,jk,ik->i", unit, np.linalg.pinv(A, rcond=_RANK), unit)
    own = unit * (gradient / np.maximum(1 - leverage, _LEAST_FREEDOM))[:, None]
    real, imaginary = np.split(own, 2)
    both = real + imaginary
    scatter = both.T @ both + least * A
    information: Array = A @ np.linalg.pinv(scatter, rcond=_RANK) @ A * np.outer(scale, scale)
    # Share (reading, parameter) of each reading in the variance; a squared chi-squared of two is 2 times its mean's.
    share = (both @ np.linalg.pinv(A, rcond=_RANK)) ** 2 + _NOTHING
    freedom = 2 * share.sum(axis=0) ** 2 / (share**2).sum(axis=0)
    return information, max(_FEWEST, int(freedom.min()))


def _inverse(matrix: Array) -> Array:
    """Inverse of a symmetric positive definite matrix whose columns differ by decades."""
    scale = np.sqrt(np.diag(matrix))
    inverse: Array = np.linalg.inv(matrix / np.outer(scale, scale)) / np.outer(scale, scale)
    symmetric: Array = (inverse + inverse.T) / 2
    return symmetric
