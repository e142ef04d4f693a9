"""Law of the steady state: share, peak and dead spot of any drive are those of the dense model."""

import numpy as np
import pytest

from base.arrays import Array, Complex
from engine.device import Device
from precompute.model.assembly import assemble
from precompute.model.gram import compute_steady_state
from tests.precompute.dense_model import DenseModel
from tests.precompute.devices import any_device


def random_amplitude(random: np.random.Generator, count: int) -> Complex:
    size, turned = random.uniform(0.01, 1, count), np.exp(2j * np.pi * random.uniform(size=count))
    return np.asarray(size * turned, dtype=np.complex128)


def compare(device: Device, frequency_hz: Array, amplitude: Complex) -> None:
    steady = compute_steady_state(assemble(device), frequency_hz, amplitude)
    expected = DenseModel(device).figures(frequency_hz, amplitude, points=2001)
    assert steady.share == pytest.approx(expected.share, rel=1e-6)
    assert steady.peak == pytest.approx(expected.peak, rel=1e-5)
    assert steady.dead == pytest.approx(expected.dead, rel=1e-3, abs=1e-3 * expected.peak.max())


@any_device
@pytest.mark.parametrize("seed", range(3))
def test_drives_of_all_and_of_some_actuators_are_those_of_the_dense_model(device: Device, seed: int) -> None:
    random, count = np.random.default_rng(seed), len(device.actuators)
    for tones in (1, count):
        frequency_hz = np.resize(random.uniform(60, 300, tones), count)
        compare(device, frequency_hz, random_amplitude(random, count))
    silent_hz, silent = [1.0] * (count - 1), [0.0] * (count - 1)
    compare(device, np.array([137.0, *silent_hz]), np.array([0.5 + 0j, *silent]))


@any_device
def test_peak_and_dead_spot_are_where_they_are_said_to_be(device: Device) -> None:
    random, count = np.random.default_rng(9), len(device.actuators)
    frequency_hz, amplitude = np.full(count, 190.0), random_amplitude(random, count)
    steady = compute_steady_state(assemble(device), frequency_hz, amplitude)
    unit = DenseModel(device).unit_acceleration
    for place, value in ((steady.peak_position_m, steady.peak), (steady.dead_position_m, steady.dead)):
        assert abs(unit(frequency_hz[:1], place.real)[0] @ amplitude) == pytest.approx(value, rel=1e-5)
    for zone, peak_m, dead_m in zip(device.zones, steady.peak_position_m, steady.dead_position_m, strict=True):
        assert zone.start_m.real <= peak_m <= zone.stop_m.real
        assert zone.start_m.real <= dead_m <= zone.stop_m.real
