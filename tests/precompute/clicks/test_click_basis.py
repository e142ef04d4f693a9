"""Laws of the tones: in their band, evenly spaced, at rest at both ends; and of percentiles over many plants."""

from itertools import pairwise

import numpy as np
import pytest

from base.arrays import Array, Single
from engine.device import Device
from precompute.clicks.click_basis import (
    SAMPLE_RATE_HZ,
    make_tones,
)
from precompute.clicks.evaluation import ManyPlants, percentiles
from tests.precompute.devices import any_device


@any_device
@pytest.mark.parametrize("length_s", [0.01, 0.02, 0.03, 0.04])
@pytest.mark.parametrize("crowding", [1.0, 1.5])
def test_tones_lie_in_the_band_evenly_as_close_as_asked(device: Device, length_s: float, crowding: float) -> None:
    tones = make_tones(device, length_s, crowding)
    time_s = (np.arange(tones.wave.shape[1]) - (tones.wave.shape[1] - 1) / 2) / SAMPLE_RATE_HZ
    window = np.cos(np.pi * time_s[1:-1] / length_s)
    for index, actuator in enumerate(device.actuators):
        cosines = tones.wave[tones.actuator == index][::2, 1:-1] / window
        step = np.arccos(np.clip(cosines[:, len(time_s) // 2], -1, 1))  # one sample after the middle
        found_hz = step * SAMPLE_RATE_HZ / (2 * np.pi)
        low_hz, high_hz = actuator.band_hz
        assert found_hz[0] - low_hz == pytest.approx(high_hz - found_hz[-1], abs=1e-6)
        assert 0 <= found_hz[0] - low_hz <= 0.5 / (crowding * length_s) + 1e-6
        assert all(b - a == pytest.approx(1 / (crowding * length_s)) for a, b in pairwise(found_hz.tolist()))


PERCENTS = (5, 50, 95)
PARAMETERS = 5


def linear_plants(count: int, seed: int) -> tuple[Array, Single, Array]:
    """Deviations (plant, parameter), courses (plant, finger, time) linear in them, and the strongest finger's peak."""
    slope = np.random.default_rng(0).normal(size=(1 + PARAMETERS, 2 * 30))
    deviation = np.random.default_rng(seed).normal(size=(count, PARAMETERS))
    course = (np.column_stack([np.ones(count), deviation]) @ slope).reshape(count, 2, 30)
    return deviation, course.astype(np.float32), abs(course).max(axis=(1, 2))


def test_where_courses_are_linear_the_percentiles_of_the_few_are_those_of_the_many() -> None:
    few, course, peak = linear_plants(12, seed=1)
    many, _, all_peaks = linear_plants(400, seed=2)
    plants = ManyPlants(few, many)
    found = plants.percentiles(course, peak, PERCENTS)
    assert found == pytest.approx(np.percentile(all_peaks, PERCENTS), rel=1e-4)
    assert plants.percentiles(course, 1.1 * peak, PERCENTS) == pytest.approx(1.1 * found)  # peaks known better scale it
    assert found != pytest.approx(np.percentile(peak, PERCENTS), rel=0.02)


@pytest.mark.parametrize("count", [1, 2, 20, 161])
def test_plain_percentiles_are_those_of_numpy(count: int) -> None:
    value, percents = np.random.default_rng(count).normal(size=count), (0, 5, 50, 95, 100)
    assert percentiles(value, percents) == pytest.approx(np.percentile(value, percents))
