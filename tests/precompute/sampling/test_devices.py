"""Sampled devices vary as the covariance of the calibration says, within its bounds."""

from dataclasses import replace

import numpy as np
import pytest

from engine.device import Device, FittedValue, Uncertainty
from precompute.measurements.parameters import find_parameters
from precompute.sampling.devices import sample_devices
from tests.precompute.devices import shipped

DEVICE = shipped("reference-a")
FITTED = Uncertainty(
    (
        FittedValue("actuator[1].stiffness", 15e3, 25e3, 0.0),
        FittedValue("actuator[2].stiffness", 15e3, 25e3, 0.0),
        FittedValue("bar.mass_damping", 0.0, 100.0, 0.3),
    ),
    ((1e-4, 0.9e-4, 0.0), (0.9e-4, 1e-4, 0.0), (0.0, 0.0, 4.0)),
)


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


def test_the_knee_of_the_file_counts_not_that_of_the_program() -> None:
    straight = replace(FITTED, fitted=(*FITTED.fitted[:2], replace(FITTED.fitted[2], knee=30.0)))
    assert values_of(sample_devices(DEVICE, straight, 50, seed=1))[:, 2].mean() > 20
    (sigma,) = find_parameters(DEVICE, ["bar.mass_damping"], {}, 0.0)
    assert sigma.knee == 0.3
