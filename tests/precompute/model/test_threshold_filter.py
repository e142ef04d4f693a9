"""Laws of the weighting: one over the threshold at every frequency, causal, with the least delay."""

import numpy as np
import pytest

from precompute.model.threshold import detection_threshold
from precompute.model.threshold_filter import threshold_filter

rates = pytest.mark.parametrize("rate_hz", [4000.0, 8000.0, 48000.0])


@rates
def test_a_steady_tone_at_its_threshold_comes_out_as_one(rate_hz: float) -> None:
    taps, tone_hz = threshold_filter(rate_hz), np.geomspace(30.0, 1000.0, 60)
    gain = np.exp(-2j * np.pi * np.outer(tone_hz, np.arange(len(taps))) / rate_hz) @ taps
    assert 20 * np.log10(abs(gain) * detection_threshold(tone_hz)) == pytest.approx(np.zeros(60), abs=0.03)


@rates
def test_it_has_the_least_delay(rate_hz: float) -> None:
    """No zero outside the unit circle (Jensen): the mean of ln|H| over all frequencies is then ln|h_0|."""
    taps = threshold_filter(rate_hz)
    response = np.fft.fft(taps, 1 << 18)
    assert np.log(abs(response)).mean() == pytest.approx(np.log(taps[0]), abs=1e-3)
