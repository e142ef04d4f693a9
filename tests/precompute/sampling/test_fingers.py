"""Sampled fingers push back as springs, dampers and masses."""

import numpy as np
from numpy.typing import NDArray

from engine.device import Device
from tests.precompute.devices import every_device, on_each
from tests.precompute.sampled import sample_fingers

Array = NDArray[np.float64]
DEVICES = every_device()
any_device = on_each(DEVICES)


@any_device
def test_dynamic_stiffness_is_k_plus_j_omega_c_minus_omega_squared_m(device: Device) -> None:
    sampled = sample_fingers(device)
    found = sampled.dynamic_stiffness(np.array([60.0, 251.0]))
    for row, frequency_hz in zip(found, (60.0, 251.0), strict=True):
        s = 2j * np.pi * frequency_hz
        expected = sampled.stiffness_n_per_m + s * sampled.damping_n_s_per_m + s**2 * sampled.mass_kg
        assert abs(row - expected).max() <= 1e-12 * abs(expected).max()
