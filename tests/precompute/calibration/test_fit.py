"""Laws of the fit: other starts leave a wrong basin, what is not told stays, bounds hold, what is held stays."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from precompute.calibration.confidence import Confidence, compute_confidence, compute_intervals
from precompute.calibration.fit import Fit, MisfitModel, fit, refit_held
from precompute.measurements.model import Flaws, MeasurementModel
from precompute.measurements.parameters import find_parameters, paper_names, with_changes
from precompute.measurements.types import Kind
from tests.precompute.calibration.calibrations import problem_of
from tests.precompute.devices import shipped
from tests.precompute.measured import NAN, TRUTH, read_bar

DEVICE = shipped("reference-a")
PARAMETERS = find_parameters(with_changes(DEVICE, TRUTH), paper_names(DEVICE), {}, 0.0)
AT_TRUTH = np.array([parameter.coordinate(TRUTH[parameter.name]) for parameter in PARAMETERS])


def test_other_starts_leave_a_basin_that_is_not_the_least() -> None:
    far = {**TRUTH, "actuator[1].stiffness": 11e3, "actuator[2].stiffness": 37e3}
    problem = problem_of(far, Flaws())
    alone, several = (fit(problem, starts, seed=0) for starts in (1, 6))
    assert alone.noise > 0.01
    assert several.noise < 1e-6
    assert np.exp(several.coordinate[:2]) == pytest.approx([11e3, 37e3], rel=1e-6)


def test_a_doubtful_basin_earns_more_starts_than_were_asked() -> None:
    """Neither of the first two starts leads to this bar."""
    stiffness = {"actuator[1].stiffness": 44.01e3, "actuator[2].stiffness": 9.41e3}
    found = fit(problem_of({**TRUTH, **stiffness}, Flaws()), 2, seed=0)
    assert np.exp(found.coordinate[:2]) == pytest.approx(list(stiffness.values()), rel=1e-6)


def test_holding_a_parameter_costs_and_costs_nothing_where_it_was() -> None:
    found = fit(problem_of(TRUTH, Flaws(noise=0.02)), 1, seed=0)
    same, cost = refit_held(found, 2, found.coordinate)
    assert cost == pytest.approx(found.cost, rel=1e-4)
    assert same[2] == found.coordinate[2]
    moved = found.coordinate + np.array([0, 0, 1.0, 0, 0, 0])
    there, dearer = refit_held(found, 2, moved)
    assert there[2] == moved[2]
    assert dearer > found.cost + 1


@cache
def fitted(noise: float = 0.02) -> tuple[Fit, Confidence]:
    found = fit(problem_of(TRUTH, Flaws(noise)), 1, seed=0)
    return found, compute_confidence(found)


def test_a_narrow_interval_is_its_standard_error_times_students_t() -> None:
    found, confidence = fitted()
    low, high = compute_intervals(found, confidence)[0]
    reach = 2.0003 * np.sqrt(confidence.covariance[0, 0])  # t of 60 degrees of freedom
    assert (high - low) / 2 == pytest.approx(reach, rel=1e-4)
    assert (high + low) / 2 == pytest.approx(found.coordinate[0], rel=1e-9)


def test_a_wide_interval_ends_where_the_cost_has_risen_or_at_a_bound() -> None:
    found, confidence = fitted(noise=0.05)
    intervals = compute_intervals(found, confidence)
    assert (intervals[:, 0] <= found.coordinate).all() and (intervals[:, 1] >= found.coordinate).all()
    sigma = found.problem.misfit.parameters[4]
    assert intervals[4, 0] == sigma.coordinate(sigma.low)  # 0 explains these readings as well
    assert sigma.value_at(float(intervals[4, 1])) > TRUTH["bar.mass_damping"]
    assert intervals[4, 1] < sigma.coordinate(sigma.high)


def test_no_noise_leaves_the_rounding_of_the_model_not_confidence() -> None:
    _, confidence = fitted(noise=0.0)
    assert 1e-11 < np.sqrt(np.diag(confidence.covariance)).min() < 1e-7


def misfit_of(kind: Kind) -> MisfitModel:
    pairs_hz = ((150, 130), (200, NAN)) if kind is Kind.PEAK else ((150, NAN), (NAN, 200))
    read = read_bar(DEVICE, TRUTH, pairs_hz, points=5, kind=kind)
    return MisfitModel(MeasurementModel(DEVICE, read, PARAMETERS), read, PARAMETERS)


@pytest.mark.parametrize("kind", Kind)
def test_there_is_none_at_the_truth_and_slopes_are_by_the_coordinates(kind: Kind) -> None:
    model = misfit_of(kind)
    assert abs(model.at(AT_TRUTH).log_residual).max() < 1e-9
    for i in range(len(PARAMETERS)):
        step = np.eye(len(PARAMETERS))[i] * 1e-5
        above, below = model.at(AT_TRUTH + step), model.at(AT_TRUTH - step)
        numeric = (above.log_residual - below.log_residual) / 2e-5
        found = model.at(AT_TRUTH).log_slope[:, i]
        assert np.abs(found - numeric).max() <= 1e-3 * np.abs(numeric).max() + 1e-6


def test_phases_differ_by_half_a_turn_at_most() -> None:
    read = read_bar(DEVICE, TRUTH, ((150, NAN),), points=5, kind=Kind.RESPONSE)
    turned = replace(read, acceleration=read.acceleration * np.exp(3.1j * np.arange(5)))
    model = MisfitModel(MeasurementModel(DEVICE, turned, PARAMETERS), turned, PARAMETERS)
    phase = model.at(AT_TRUTH).log_residual[5:]
    assert np.abs(phase).max() <= np.pi
    assert np.exp(1j * phase) == pytest.approx(np.exp(-3.1j * np.arange(5)), abs=1e-9)
