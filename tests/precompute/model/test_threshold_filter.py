"""Laws of the weighting: one over the threshold at every frequency, causal, with the least delay."""

import numpy as np
import pytest

from engine.device import Threshold
from engine.device.threshold import DEFAULT, shipped_threshold, shipped_thresholds
from precompute.model.transfers import threshold_filter

rates = pytest.mark.parametrize("rate_hz", [4000.0, 8000.0, 48000.0])
TOLERANCE_DB = {DEFAULT: 0.03, "android": 0.2}
"""A curve with corners close to each other needs a longer filter than 0.1 s."""
curves = pytest.mark.parametrize("curve", list(map(shipped_threshold, shipped_thresholds())), ids=shipped_thresholds())


@rates
@curves
def test_a_steady_tone_at_its_threshold_comes_out_as_one_with_the_least_delay(curve: Threshold, rate_hz: float) -> None:
    """No zero outside the unit circle (Jensen): the mean of ln|H| over all frequencies is then ln|h_0|."""
    taps, tone_hz = threshold_filter(curve, rate_hz), np.geomspace(30.0, 1000.0, 60)
    gain = np.exp(-2j * np.pi * np.outer(tone_hz, np.arange(len(taps))) / rate_hz) @ taps
    assert 20 * np.log10(abs(gain) * curve.peak_m_per_s2(tone_hz)) == pytest.approx(
        np.zeros(60), abs=TOLERANCE_DB[curve.name]
    )
    response = np.fft.fft(taps, 1 << 18)
    assert np.log(abs(response)).mean() == pytest.approx(np.log(taps[0]), abs=1e-3)
