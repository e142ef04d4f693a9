"""Laws of the tones: in their band, evenly spaced, at rest at both ends."""

from itertools import pairwise

import numpy as np
import pytest

from engine.device import Device
from precompute.clicks.click_basis import (
    SAMPLE_RATE_HZ,
    make_tones,
)
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
