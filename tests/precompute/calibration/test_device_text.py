"""Laws of the new device file: it is read again, comments stay, and marks of estimates go."""

from dataclasses import replace

import numpy as np
import pytest

from engine.device import Device
from precompute.calibration.calibrate import calibrate
from precompute.calibration.fitted import calibrated_text
from precompute.measurements.model import Flaws
from tests.precompute.calibration.calibrations import DEVICE, noisy_calibration
from tests.precompute.measured import read_bar

PROVENANCE = {"created": "2026-11-21T12:00:00+00:00", "measurements": "measurements.csv"}


def test_the_new_file_has_the_fitted_values_with_how_well_they_are_known_and_nothing_else_changed() -> None:
    found = noisy_calibration()
    read = Device.parse(calibrated_text(found, PROVENANCE), "new.toml")
    expected = found.device
    for actual, wanted in zip(read.actuators, expected.actuators, strict=True):
        assert actual.stiffness_n_per_m == pytest.approx(wanted.stiffness_n_per_m, rel=1e-9)
        assert actual.full_scale_m == pytest.approx(wanted.full_scale_m, rel=1e-9)
    assert read.bar.stiffness_damping_s == pytest.approx(expected.bar.stiffness_damping_s, rel=1e-9)
    same = replace(read, surface=DEVICE.bar, actuators=DEVICE.actuators, uncertainty=None, text=DEVICE.text)
    assert same == DEVICE
    assert read.fingerprint != DEVICE.fingerprint
    assert read.uncertainty is not None
    assert [value.name for value in read.uncertainty.fitted] == [p.name for p in found.parameters]
    assert np.array(read.uncertainty.covariance) == pytest.approx(found.covariance, rel=1e-12)
    for value, parameter in zip(read.uncertainty.fitted, found.parameters, strict=True):
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


def test_a_bar_that_is_fitted_without_any_damping_is_written_with_the_least_and_can_be_read() -> None:
    names = ["actuator.damping", "bar.mass_damping", "bar.stiffness_damping"]
    found = calibrate(DEVICE, read_bar(DEVICE, {}, flaws=Flaws(0.01)), names, starts=1)
    undamped = replace(found, estimates=tuple(replace(estimate, value=0.0) for estimate in found.estimates))
    read = Device.parse(calibrated_text(undamped, PROVENANCE), "new.toml")
    assert (read.bar.mass_damping_per_s, read.bar.stiffness_damping_s) == (0.0, 1e-9)
    assert [actuator.damping_n_s_per_m for actuator in read.actuators] == [0.0, 0.0]
