"""Laws of the confidence: textbook covariance without outliers, profiles where the likelihood bends, honest bounds."""

from functools import cache

import numpy as np
import pytest

from precompute.calibration.confidence import Confidence, compute_confidence, compute_intervals
from precompute.calibration.fit import Fit, fit
from precompute.calibration.misfit import Loss
from precompute.measurements.simulate import Flaws
from tests.precompute.calibration.calibrations import problem_of
from tests.precompute.measured import TRUTH


@cache
def fitted(loss: Loss, noise: float = 0.02) -> tuple[Fit, Confidence]:
    found = fit(problem_of(TRUTH, Flaws(noise)), loss, 1, seed=0)
    return found, compute_confidence(found)


def test_plain_squares_have_the_covariance_of_the_textbook() -> None:
    found, confidence = fitted(Loss.SQUARES)
    slope, residual = found.misfit.log_slope, found.misfit.log_residual
    variance = residual @ residual / (len(residual) - slope.shape[1])
    assert confidence.information == pytest.approx(slope.T @ slope / variance, rel=1e-9)
    well = np.ix_([0, 1, 3], [0, 1, 3])  # the others lean on the prior
    assert confidence.covariance[well] == pytest.approx(np.linalg.inv(confidence.information)[well], rel=0.05)
    assert confidence.freedom == 60


@pytest.mark.parametrize("loss", Loss)
def test_a_narrow_interval_is_its_standard_error_times_students_t(loss: Loss) -> None:
    found, confidence = fitted(loss)
    low, high = compute_intervals(found, confidence)[0]
    reach = 2.0003 * np.sqrt(confidence.covariance[0, 0])  # t of 60 degrees of freedom
    assert (high - low) / 2 == pytest.approx(reach, rel=1e-4)
    assert (high + low) / 2 == pytest.approx(found.coordinate[0], rel=1e-9)


def test_a_wide_interval_ends_where_the_cost_has_risen_or_at_a_bound() -> None:
    found, confidence = fitted(Loss.ROBUST, noise=0.05)
    intervals = compute_intervals(found, confidence)
    assert (intervals[:, 0] <= found.coordinate).all() and (intervals[:, 1] >= found.coordinate).all()
    sigma = found.problem.misfit.parameters[4]
    assert intervals[4, 0] == sigma.coordinate(sigma.low)  # 0 explains these readings as well
    assert sigma.value_at(float(intervals[4, 1])) > TRUTH["bar.mass_damping"]
    assert intervals[4, 1] < sigma.coordinate(sigma.high)


def test_no_noise_leaves_the_rounding_of_the_model_not_confidence() -> None:
    _, confidence = fitted(Loss.ROBUST, noise=0.0)
    assert 1e-11 < np.sqrt(np.diag(confidence.covariance)).min() < 1e-7
