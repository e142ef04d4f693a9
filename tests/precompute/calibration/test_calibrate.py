"""What a calibration must show: known bars found again, honest intervals, wrong readings survived, gaps admitted."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import pyuff

from precompute.calibration.calibrate import Calibration, Known, calibrate, names_told
from precompute.calibration.remedy import find_remedy
from precompute.measurements.measurement_file import read_measurements
from precompute.measurements.model import Flaws
from precompute.measurements.parameters import ParameterError, default_names, paper_names, with_changes
from precompute.measurements.types import Kind, MeasurementError, Measurements
from precompute.measurements.uff import write_uff
from tests.precompute.calibration.calibrations import DEVICE
from tests.precompute.devices import with_actuators
from tests.precompute.measured import NAN, PAIRS_HZ, TRUTH, read_bar
from tests.precompute.measurements.test_response_table import per_newton

PAPERS_SIX = paper_names(DEVICE)


def relative_errors(found: Calibration, truth: dict[str, float]) -> dict[str, float]:
    return {e.parameter.name: abs(e.value / truth[e.parameter.name] - 1) for e in found.estimates}


@pytest.mark.parametrize(
    "truth",
    [
        TRUTH,
        {"bar.youngs_modulus": 66e9, "bar.density": 2900.0, "actuator.full_scale": 0.4e-6},
        {"actuator[1].mass": 8e-3, "actuator[2].mass": 12e-3, "actuator.full_scale": 0.4e-6},
    ],
)
def test_without_noise_the_papers_six_and_others_are_found_to_1e_6(truth: dict[str, float]) -> None:
    found = calibrate(DEVICE, read_bar(DEVICE, truth), list(truth), starts=3)
    errors = relative_errors(found, truth)
    assert max(errors.values()) < 1e-6, errors
    assert all(estimate.known is Known.WELL for estimate in found.estimates)


def test_the_length_that_bolts_clamp_is_found_beside_stiffness_modulus_and_masses() -> None:
    """From a file that says 20 mm, or within bounds; with noise within three standard errors, at most 3 mm."""
    device = with_actuators(DEVICE, clamp_m=0.02)
    truth = {"actuator[1].clamp": 0.016, "actuator[2].clamp": 0.023, "actuator[1].stiffness": 20e3}
    names = (*default_names(DEVICE), "actuator[1].clamp", "actuator[2].clamp", "actuator.mass")
    exact = {
        each.parameter.name: each for each in calibrate(device, read_bar(device, truth), names, starts=1).estimates
    }
    noisy = calibrate(device, read_bar(device, truth, PAIRS_HZ, Flaws(noise=0.02)), names, starts=1)
    for estimate, most_m in zip(noisy.estimates[-3:-1], (3e-4, 3e-3), strict=True):
        value = truth[estimate.parameter.name]
        assert exact[estimate.parameter.name].value == pytest.approx(value, rel=1e-4)
        assert estimate.known is Known.WELL and 0 < estimate.standard_error < most_m
        assert abs(estimate.value - value) < 3 * estimate.standard_error
    unsaid = calibrate(
        DEVICE, read_bar(device, {}), ["actuator.clamp"], bounds={"actuator.clamp": (2e-3, 0.06)}, starts=2
    )
    assert unsaid.estimates[0].value == pytest.approx(0.02, rel=1e-4)
    with pytest.raises(ParameterError, match=r"actuator\.clamp: is 0 in the description, .* give bounds"):
        calibrate(DEVICE, read_bar(device, {}), ["actuator.clamp"])


def test_the_delay_of_a_channel_is_found_from_responses_and_named_where_it_was_not_fitted() -> None:
    truth = {"actuator[2].delay": 125e-6, "actuator[1].stiffness": 20e3}
    hz = np.arange(60.0, 301.0, 20.0)
    alone = [[each, NAN] for each in hz] + [[NAN, each] for each in hz]
    read = read_bar(DEVICE, truth, alone, Flaws(noise=0.02), kind=Kind.RESPONSE, points=8)
    delays = "actuator[1].delay", "actuator[2].delay"
    found = calibrate(DEVICE, read, (*default_names(DEVICE), *delays), starts=1)
    early, late = found.estimates[-2:]
    assert late.low < 125e-6 < late.high < late.low + 10e-6 and late.known is Known.WELL
    assert early.low == 0.0 and early.known is Known.AT_MOST and early.high < 5e-6
    names = ["actuator.damping", "actuator[1].stiffness", "bar.youngs_modulus"]
    unsaid = calibrate(DEVICE, read, names, starts=1)
    remedy = find_remedy(DEVICE, unsaid, {})
    assert remedy is not None and remedy.name == "actuator[2].delay"
    peaks = calibrate(DEVICE, read_bar(DEVICE, {}, [[150.0, NAN]]), ["actuator[1].delay"], starts=1)
    assert peaks.estimates[0].known is Known.NOT


def test_each_actuator_has_its_own_full_scale_unless_it_stood_still() -> None:
    own = {"actuator[1].full_scale": 0.5e-6, "actuator[2].full_scale": 0.56e-6}
    read = read_bar(DEVICE, own)
    errors = relative_errors(
        calibrate(DEVICE, read, starts=1), own | {name: np.inf for name in default_names(DEVICE) if name not in own}
    )
    assert max(errors[name] for name in own) < 1e-6
    still = replace(read, amplitude=read.amplitude * [1, 0])
    assert set(default_names(DEVICE)) - set(names_told(still, default_names(DEVICE))) == {"actuator[2].full_scale"}


def test_a_tenth_of_the_readings_may_be_wrong_by_3() -> None:
    flawless = read_bar(DEVICE, TRUTH, PAIRS_HZ[:5])
    flawed = read_bar(DEVICE, TRUTH, PAIRS_HZ[:5], Flaws(wrong=0.1))
    found = calibrate(DEVICE, flawed, PAPERS_SIX, starts=2)
    assert max(relative_errors(found, TRUTH).values()) < 1e-5
    assert (found.is_wrong == (np.abs(flawed.acceleration / flawless.acceleration - 1) > 0.5)).all()


def test_a_reading_is_not_wrong_within_what_a_sensor_is_good_for() -> None:
    """A clean fit has next to no noise, so that every rounding would be far beyond it."""
    read = read_bar(DEVICE, TRUTH, PAIRS_HZ[:5])
    read.acceleration[[3, 40]] *= 1.008, 1.02
    assert np.flatnonzero(calibrate(DEVICE, read, PAPERS_SIX, starts=2).is_wrong).tolist() == [40]


def test_responses_per_newton_give_the_bar_but_no_full_scale(tmp_path: Path) -> None:
    truth = {name: value for name, value in TRUTH.items() if "full_scale" not in name} | {"bar.youngs_modulus": 67e9}
    csv, uff = tmp_path / "bar.csv", tmp_path / "bar.uff"
    csv.write_text(per_newton(with_changes(DEVICE, truth), np.arange(70.0, 300.0, 25.0), 4), encoding="utf-8")
    read = read_measurements(csv, DEVICE)
    write_uff(uff, replace(read, force_m=None), DEVICE, "")
    sets = pyuff.UFF(str(uff)).read_sets()
    pyuff.UFF(str(uff)).write_sets([each | {"orddenom_spec_data_type": 13} for each in sets], mode="overwrite")
    for each in (read, read_measurements(uff, DEVICE)):
        found = calibrate(DEVICE, each, starts=1)
        assert max(relative_errors(found, truth).values()) < 1e-3
        assert [a.full_scale_m for a in found.device.actuators] == [a.full_scale_m for a in DEVICE.actuators]
    assert names_told(read, ["actuator.full_scale"]) == ("actuator.full_scale",)  # asked for, so refused
    with pytest.raises(MeasurementError, match=r"actuator\.full_scale: changes none of these readings"):
        calibrate(DEVICE, read, ["actuator.full_scale"], starts=1)


def test_only_what_is_named_is_fitted_within_its_bounds() -> None:
    bounds = {"bar.density": (2600.0, 2650.0)}
    found = calibrate(DEVICE, read_bar(DEVICE, {}), ["bar.density", "actuator[1].mass"], bounds=bounds, starts=2)
    density, mass = found.estimates
    assert 2600 <= density.value <= 2650 and density.known is Known.AT_LEAST
    changed = replace(found.device, surface=DEVICE.bar, actuators=DEVICE.actuators)
    assert changed == DEVICE
    assert found.device.actuators[0].mass_kg == mass.value


def test_a_sensor_that_weighs_what_nobody_said_is_weighed() -> None:
    read = read_bar(DEVICE, {"actuator[2].full_scale": 0.4e-6})
    told = replace(read, sensor_mass_kg=np.full(len(read), 1.5e-3))
    found = calibrate(DEVICE, told, ["actuator[2].full_scale", "sensor.mass"], starts=1)
    assert [estimate.value for estimate in found.estimates] == pytest.approx([0.4e-6, 2e-3], rel=1e-6)


def test_complex_responses_are_fitted_too() -> None:
    drives_hz = [(hz, NAN) for hz in (110, 150, 190)] + [(NAN, hz) for hz in (130, 180, 205)]
    read = read_bar(DEVICE, TRUTH, drives_hz, Flaws(noise=0.01, wrong=0.05), points=9, kind=Kind.RESPONSE)
    found = calibrate(DEVICE, read, PAPERS_SIX, starts=2)
    errors = relative_errors(found, TRUTH)
    assert max(errors["actuator[1].stiffness"], errors["actuator[2].stiffness"], errors["actuator.full_scale"]) < 0.01
    assert found.is_wrong.sum() == 3  # of 54
    assert found.predicted.dtype == np.complex128


def test_the_uncertainty_of_a_file_leaves_the_sensor_out() -> None:
    found = calibrate(DEVICE, read_bar(DEVICE, {}, flaws=Flaws(0.01)), ["sensor.mass", "actuator.full_scale"], starts=1)
    uncertainty = found.uncertainty
    assert [value.name for value in uncertainty.fitted] == ["actuator.full_scale"]
    assert uncertainty.covariance[0][0] == found.covariance[1, 1]
    assert np.diag(found.correlation) == pytest.approx(1.0)


READ = read_bar(DEVICE, {})


@pytest.mark.parametrize(
    ("names", "read", "error", "message"),
    [
        (["bar.densty"], READ, ParameterError, "did you mean bar.density?"),
        (["finger.mass", "bar.density"], READ, MeasurementError, "finger.mass: changes none of these readings"),
        (None, READ.part(np.arange(6)), MeasurementError, "6 readings cannot fit 8 parameters"),
        (None, READ.part(np.tile(np.arange(6), 9)), MeasurementError, "54 readings, 6 without repetitions, "),
        (None, READ.part(np.tile(np.arange(66), 200)), MeasurementError, "13200 readings; expected at most 10000"),
    ],
)
def test_what_cannot_be_fitted_is_refused(
    names: list[str] | None, read: Measurements, error: type[Exception], message: str
) -> None:
    with pytest.raises(error) as caught:
        calibrate(DEVICE, read, names)
    assert message in str(caught.value)
