"""Sampled devices vary within the bounds of the calibration; test_plants.py has that they do as its covariance says."""

import numpy as np

from base.arrays import Array
from engine.device import FittedValue, Uncertainty
from precompute.measurements.parameters import find_parameters
from precompute.sampling.devices import sample_devices
from tests.precompute.devices import shipped

DEVICE = shipped("reference-a")


def sampled_damping(knee: float) -> Array:
    """Damping by mass of devices of which a calibration has left it open from 0 to 100 1/s."""
    known = Uncertainty((FittedValue("bar.mass_damping", 0.0, 100.0, knee),), ((4.0,),))
    return np.array([device.bar.mass_damping_per_s for device in sample_devices(DEVICE, known, 500, seed=2)])


def test_the_knee_of_the_file_counts_not_that_of_the_program() -> None:
    assert sampled_damping(knee=30.0).mean() > 20
    (sigma,) = find_parameters(DEVICE, ["bar.mass_damping"], {}, 0.0)
    assert sigma.knee == 0.3
