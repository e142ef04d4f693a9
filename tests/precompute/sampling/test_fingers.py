"""Laws of the sampled fingers: within zone and spread, the same every time, even, their own mirror image."""

import numpy as np
import pytest
from numpy.typing import NDArray

from engine.device import Device
from precompute.sampling.fingers import PLACES, SAMPLES, SampledFingers, sample_fingers
from tests.precompute.devices import every_device, on_each

Array = NDArray[np.float64]
DEVICES = every_device()
any_device = on_each(DEVICES)


def positions(sampled: SampledFingers) -> Array:
    """Shape (case, zone), metres."""
    out: Array = np.take_along_axis(sampled.position_m.T, sampled.place, axis=0)
    return out


def parameters(sampled: SampledFingers) -> Array:
    """Shape (parameter, case, zone)."""
    return np.stack([sampled.mass_kg, sampled.damping_n_s_per_m, sampled.stiffness_n_per_m])


@any_device
def test_the_first_touch_is_the_standard_finger_at_every_middle(device: Device) -> None:
    sampled, finger = sample_fingers(device), device.finger
    middles = [(zone.start_m + zone.stop_m) / 2 for zone in device.zones]
    assert positions(sampled)[0] == pytest.approx(middles)
    assert sampled.middle_m == pytest.approx(middles)
    standard = [finger.mass_kg, finger.damping_n_s_per_m, finger.stiffness_n_per_m]
    assert parameters(sampled)[:, 0] == pytest.approx(np.repeat(np.array(standard)[:, None], len(middles), axis=1))


@any_device
def test_every_finger_lies_within_its_zone_and_varies_within_the_spread(device: Device) -> None:
    sampled = sample_fingers(device)
    starts, stops = np.array([(zone.start_m, zone.stop_m) for zone in device.zones]).T
    assert (positions(sampled) > starts).all() and (positions(sampled) < stops).all()
    factor = parameters(sampled) / parameters(sampled)[:, :1]
    spread = device.finger.spread * (1 + 1e-12)
    assert (factor >= 1 / spread).all() and (factor <= spread).all()
    assert factor.max() > 0.9 * device.finger.spread and factor.min() < 1 / (0.9 * device.finger.spread)


@any_device
def test_samples_are_even_over_places_and_over_the_logarithms_of_the_spread(device: Device) -> None:
    sampled = sample_fingers(device)
    for zone in range(len(device.zones)):
        counts = np.bincount(sampled.place[1:, zone], minlength=PLACES)
        assert counts.min() >= SAMPLES // PLACES - 2 and counts.max() <= SAMPLES // PLACES + 2
    octave = np.log(parameters(sampled)[:, 1:] / parameters(sampled)[:, :1]) / np.log(device.finger.spread)
    assert abs(octave.mean(axis=1)).max() < 0.15  # of -1 to 1
    assert (abs(octave.std(axis=1) - 1 / np.sqrt(3)) < 0.1).all()


@any_device
def test_half_of_the_samples_are_the_mirror_images_of_the_others(device: Device) -> None:
    sampled = sample_fingers(device)
    half = SAMPLES // 2
    one, other = slice(1, 1 + half), slice(1 + half, None)
    assert (sampled.place[other, ::-1] == PLACES - 1 - sampled.place[one]).all()
    assert parameters(sampled)[:, other, ::-1] == pytest.approx(parameters(sampled)[:, one])


@any_device
def test_dynamic_stiffness_is_k_plus_j_omega_c_minus_omega_squared_m(device: Device) -> None:
    sampled = sample_fingers(device)
    found = sampled.dynamic_stiffness(np.array([60.0, 251.0]))
    for row, frequency_hz in zip(found, (60.0, 251.0), strict=True):
        s = 2j * np.pi * frequency_hz
        expected = sampled.stiffness_n_per_m + s * sampled.damping_n_s_per_m + s**2 * sampled.mass_kg
        assert abs(row - expected).max() <= 1e-12 * abs(expected).max()
