"""Laws of the new device file: it is read again, comments stay, marks go, and sampled devices have its covariance."""

from dataclasses import replace

import numpy as np
import pytest

from engine.device import Device, FittedValue, Uncertainty
from precompute.calibration.calibrate import calibrate
from precompute.calibration.device_text import calibrated_text, sample_devices
from precompute.measurements.parameters import find_parameters
from precompute.measurements.simulate import Flaws
from tests.precompute.calibration.calibrations import DEVICE, noisy_calibration
from tests.precompute.measured import read_bar

PROVENANCE = {"created": "2026-11-21T12:00:00+00:00", "measurements": "measurements.csv", "loss": "robust"}
FITTED = Uncertainty(
    (
        FittedValue("actuator[1].stiffness", 15e3, 25e3, 0.0),
        FittedValue("actuator[2].stiffness", 15e3, 25e3, 0.0),
        FittedValue("bar.mass_damping", 0.0, 100.0, 0.3),
    ),
    ((1e-4, 0.9e-4, 0.0), (0.9e-4, 1e-4, 0.0), (0.0, 0.0, 4.0)),
)


def test_the_new_file_has_the_fitted_values_and_nothing_else_changed() -> None:
    found = noisy_calibration()
    read = Device.parse(calibrated_text(found, PROVENANCE), "new.toml")
    expected = found.device
    for actual, wanted in zip(read.actuators, expected.actuators, strict=True):
        assert actual.stiffness_n_per_m == pytest.approx(wanted.stiffness_n_per_m, rel=1e-9)
        assert actual.full_scale_m == pytest.approx(wanted.full_scale_m, rel=1e-9)
    assert read.bar.stiffness_damping_s == pytest.approx(expected.bar.stiffness_damping_s, rel=1e-9)
    same = replace(read, bar=DEVICE.bar, actuators=DEVICE.actuators, uncertainty=None, text=DEVICE.text)
    assert same == DEVICE
    assert read.fingerprint != DEVICE.fingerprint


def test_the_new_file_says_how_well_the_values_are_known() -> None:
    found = noisy_calibration()
    uncertainty = Device.parse(calibrated_text(found, PROVENANCE), "new.toml").uncertainty
    assert uncertainty is not None
    assert [value.name for value in uncertainty.fitted] == [p.name for p in found.parameters]
    assert np.array(uncertainty.covariance) == pytest.approx(found.covariance, rel=1e-12)
    for value, parameter in zip(uncertainty.fitted, found.parameters, strict=True):
        assert (value.low, value.high) == pytest.approx((parameter.low, parameter.high), rel=1e-9)
        assert value.knee == pytest.approx(parameter.knee)


def test_comments_stay_and_what_was_fitted_is_no_estimate_any_more() -> None:
    found = calibrate(DEVICE, read_bar(DEVICE, {}, flaws=Flaws(0.01)), ["actuator[1].mass"], starts=1)
    text = calibrated_text(found, PROVENANCE)
    assert "# REF-A: the aluminium touch bar" in text and "# sigma in C = C_A + sigma M + eta K" in text
    read = Device.parse(text, "new.toml")
    assert set(DEVICE.inferred) - set(read.inferred) == {"actuator[1].mass"}


def test_a_calibrated_file_can_be_calibrated_again() -> None:
    first = Device.parse(calibrated_text(noisy_calibration(), PROVENANCE), "first.toml")
    found = calibrate(first, noisy_calibration().measurements, ["actuator.full_scale"], starts=1)
    second = Device.parse(calibrated_text(found, PROVENANCE), "second.toml")
    assert second.uncertainty is not None
    assert [value.name for value in second.uncertainty.fitted] == ["actuator.full_scale"]


def values_of(devices: list[Device]) -> np.ndarray:
    return np.array([[a.stiffness_n_per_m for a in d.actuators] + [d.bar.mass_damping_per_s] for d in devices])


def test_sampled_devices_vary_together_as_the_covariance_says() -> None:
    values = values_of(sample_devices(DEVICE, FITTED, 2000, seed=1))
    log = np.log(values[:, :2])
    assert np.cov(log.T) == pytest.approx(np.array(FITTED.covariance)[:2, :2], rel=0.15)
    assert log.mean(axis=0) == pytest.approx(np.log([18.9e3, 17.5e3]), abs=1e-3)


def test_sampled_devices_stay_within_the_bounds_without_piling_up_there() -> None:
    values = values_of(sample_devices(DEVICE, FITTED, 500, seed=2))
    assert (values[:, 2] >= 0).all() and (values[:, 2] <= 100).all()
    assert (values[:, 2] == 0).mean() < 0.01


def test_sampled_devices_depend_on_their_seed_alone() -> None:
    first, again, other = (values_of(sample_devices(DEVICE, FITTED, 3, seed=s)) for s in (7, 7, 8))
    assert (first == again).all() and (first != other).any()


def test_the_knee_of_the_file_counts_not_that_of_the_program() -> None:
    straight = replace(FITTED, fitted=(*FITTED.fitted[:2], replace(FITTED.fitted[2], knee=30.0)))
    assert values_of(sample_devices(DEVICE, straight, 50, seed=1))[:, 2].mean() > 20
    (sigma,) = find_parameters(DEVICE, ["bar.mass_damping"], {}, 0.0)
    assert sigma.knee == 0.3
