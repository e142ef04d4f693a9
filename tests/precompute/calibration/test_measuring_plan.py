"""Laws of a plan: each reading shrinks what is unknown as predicted, the best first, nodes avoided, bands kept."""

from dataclasses import replace

import numpy as np
import pytest

from precompute.calibration.calibrate import Known, calibrate
from precompute.calibration.confidence import Confidence
from precompute.calibration.measuring_plan import (
    Accuracy,
    open_combinations,
    plan_after,
    plan_first,
    plan_readings,
    prior_information,
    propose_candidates,
)
from precompute.measurements.model import Flaws, MeasurementModel
from precompute.measurements.parameters import find_parameters, paper_names
from precompute.measurements.types import lay_out
from tests.precompute.calibration.calibrations import DEVICE, noisy_calibration, published_calibration
from tests.precompute.devices import random_device
from tests.precompute.measured import NAN, read_bar

PARAMETERS = find_parameters(DEVICE, paper_names(DEVICE), {}, 0.0)
START = np.array([parameter.coordinate(parameter.start) for parameter in PARAMETERS])
CANDIDATES = propose_candidates(DEVICE, PARAMETERS, START, 2e-3, Accuracy())
PRIOR = prior_information(PARAMETERS)


@pytest.mark.parametrize("index", [(5, 7), (500, 3), (1500, 20)])
def test_a_candidate_has_the_slope_that_its_reading_would_have(index: tuple[int, int]) -> None:
    drive, point = index
    row = lay_out(CANDIDATES.frequency_hz[[drive]], CANDIDATES.position_m[[point]], 2e-3)
    found = MeasurementModel(DEVICE, row, PARAMETERS).predict(np.array([p.start for p in PARAMETERS]))
    rate = np.array([p.rate_at(x) for p, x in zip(PARAMETERS, START, strict=True)])
    slope = found.by_parameter[0].real * rate
    ratio = CANDIDATES.slope[drive, point] / slope
    assert ratio == pytest.approx(ratio[0], rel=1e-6)
    assert 0 < ratio[0] <= 1 / Accuracy().relative


def test_candidates_keep_to_the_bands_and_do_not_beat() -> None:
    device = random_device(seed=4)
    parameters = find_parameters(device, ["actuator.full_scale"], {}, 0.0)
    start = np.array([parameters[0].coordinate(parameters[0].start)])
    hz = propose_candidates(device, parameters, start, 0.0, Accuracy()).frequency_hz
    moved = (~np.isnan(hz)).sum(axis=1)
    assert set(moved.tolist()) == {1, 2}
    assert np.nanmin(hz) >= 60 and np.nanmax(hz) <= 300
    pairs = np.sort(hz[moved == 2], axis=1)
    assert (pairs[:, 1] - pairs[:, 0]).min() >= 10


def test_readings_shrink_what_is_unknown_as_the_inverse_says() -> None:
    steps = plan_readings(CANDIDATES, PRIOR, 6)
    information = PRIOR.copy()
    for step in steps:
        assert step.before == pytest.approx(np.sqrt(np.diag(np.linalg.inv(information))), rel=1e-6)
        same = np.nan_to_num(CANDIDATES.frequency_hz) == np.nan_to_num(np.array(step.drive_hz))
        drive = int(np.flatnonzero(same.all(axis=1))[0])
        slope = CANDIDATES.slope[drive, int(np.abs(CANDIDATES.position_m - step.position_m).argmin())]
        information += np.outer(slope, slope)
        assert step.after == pytest.approx(np.sqrt(np.diag(np.linalg.inv(information))), rel=1e-6)
        assert (step.after <= step.before * (1 + 1e-12)).all()
    assert len({(str(step.drive_hz), step.position_m) for step in steps}) == 6


def test_the_first_reading_shrinks_the_volume_of_what_is_unknown_most() -> None:
    slope = CANDIDATES.slope.reshape(-1, len(PARAMETERS))
    prior = np.linalg.inv(PRIOR)
    told = np.einsum("cp,pq,cq->c", slope, prior, slope)
    step = plan_readings(CANDIDATES, PRIOR, 1)[0]
    drive, point = divmod(int(told.argmax()), len(CANDIDATES.position_m))
    np.testing.assert_array_equal(step.drive_hz, CANDIDATES.frequency_hz[drive])
    assert step.position_m == CANDIDATES.position_m[point]
    ratio = np.linalg.det(PRIOR + np.outer(slope[told.argmax()], slope[told.argmax()])) / np.linalg.det(PRIOR)
    assert ratio == pytest.approx(1 + told.max(), rel=1e-6)


def test_a_plan_after_measurements_begins_where_they_end() -> None:
    found = noisy_calibration()
    plan = plan_after(found, Accuracy(), 4)
    confidence = Confidence(found.information, found.information, np.array([p.prior for p in found.parameters]), 60)
    assert plan.steps[0].before == pytest.approx(np.sqrt(np.diag(confidence.covariance)), rel=1e-6)
    summary = plan.summary()
    assert len(summary["readings"]) == 4
    for parameter in summary["parameters"]:
        assert parameter["standard_error_after"] <= parameter["standard_error"]
    assert all(0 <= shrunk < 1 for step in summary["readings"] for shrunk in step["shrinks"].values())


def test_a_plan_with_nothing_measured_begins_with_the_bounds() -> None:
    plan = plan_first(DEVICE, ["bar.density"], {"bar.density": (2600, 2800)}, 0.0, Accuracy(), 1)
    (parameter,) = plan.parameters
    assert plan.steps[0].before[0] == pytest.approx(parameter.prior)
    assert replace(parameter, low=1.0).prior > parameter.prior


def test_sigma_next_to_0_is_said_to_change_nothing_and_known_at_most() -> None:
    """1.008e-5 1/s: less than a 200 000th of the damping. The interval holds it, and all that explains as well."""
    stiffness, *_, sigma, _ = published_calibration().estimates
    assert (stiffness.known, sigma.known) == (Known.WELL, Known.AT_MOST)
    assert sigma.low <= DEVICE.bar.mass_damping_per_s <= sigma.high
    assert 0.5 < sigma.high < 50
    (combination,) = open_combinations(published_calibration())
    assert combination.text == "bar.mass_damping alone: it hardly changes what was measured"
    assert combination.singular_value < 2


def test_two_parameters_that_do_the_same_are_named_together() -> None:
    """Spring and mass of an actuator push alike at one frequency: only k - omega^2 m counts."""
    read = read_bar(DEVICE, {}, ((150, NAN),), Flaws(noise=0.2), points=12)
    found = calibrate(DEVICE, read, ["actuator[2].stiffness", "actuator[2].mass"], starts=1)
    (combination,) = open_combinations(found)
    assert combination.text == (
        "actuator[2].mass up with actuator[2].stiffness up: together they hardly change what was measured"
    )
    assert abs(found.correlation[0, 1]) > 0.95


def test_directions_are_unit_vectors_ordered_by_what_is_known_of_them() -> None:
    combinations = open_combinations(noisy_calibration())
    assert [c.singular_value for c in combinations] == sorted(c.singular_value for c in combinations)
    for combination in combinations:
        sizes = [*combination.parts.values()]
        assert np.linalg.norm(sizes) <= 1 + 1e-9
        assert sizes[0] == pytest.approx(max(sizes))
