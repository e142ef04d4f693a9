"""A recorded sweep becomes the response of what lies between its two channels, with an honest error."""

import math

import numpy as np
import pytest
from scipy import signal

from base.arrays import Array, Complex
from tactable.measure.sweep_fit import SweepFit, fit_sweep

RATE_HZ, LOW_HZ, HIGH_HZ, SWEEP_S, GATE_S = 4_000.0, 60.0, 300.0, 3.0, 1.0
STRETCH_S = SWEEP_S / math.log(HIGH_HZ / LOW_HZ)
HZ = np.array([60.0, 100.0, 149.0, 150.0, 151.0, 220.0, 300.0])
NUMERATOR, DENOMINATOR = signal.bilinear([0.2, 0.0, 0.0], [1.0, 12.0, (2 * np.pi * 150) ** 2], RATE_HZ)
"""An accelerance with a mode near 150 Hz that decays by 6 a second."""


def sweep() -> Array:
    """Drive (sample,): rest, an exponential sweep, rest."""
    time_s = np.arange(round(SWEEP_S * RATE_HZ)) / RATE_HZ
    phase = 2 * np.pi * LOW_HZ * STRETCH_S * (np.exp(time_s / STRETCH_S) - 1)
    ends = np.minimum(1, np.minimum(time_s, time_s[::-1]) / 0.005)
    return np.concatenate([np.zeros(1_400), ends * np.sin(phase), np.zeros(6_000)])


def moved(drive: Array) -> Array:
    return np.asarray(signal.lfilter(NUMERATOR, DENOMINATOR, drive))


def true_response() -> Complex:
    return np.asarray(signal.freqz(NUMERATOR, DENOMINATOR, HZ, fs=RATE_HZ)[1])


def fit(acceleration: Array, drive: Array) -> SweepFit:
    return fit_sweep(acceleration, drive, RATE_HZ, HZ, STRETCH_S, GATE_S)


def test_the_response_is_right_at_the_ends_of_the_band_and_on_a_narrow_mode() -> None:
    found = fit(moved(sweep()) + 9.81, sweep())
    np.testing.assert_allclose(found.response, true_response(), rtol=0.01)
    assert found.error.max() < 0.02
    assert found.distortion < 1e-3


def test_the_error_is_what_noise_does() -> None:
    random, own = np.random.default_rng(3), []
    stated = []
    for _ in range(20):
        found = fit(moved(sweep()) + 0.05 * random.standard_normal(len(sweep())), sweep())
        own.append(found.response)
        stated.append(found.error)
    scatter = np.std(own, axis=0) / abs(true_response())
    ratio = np.sqrt(np.mean(np.square(stated), axis=0)) / scatter
    assert (ratio > 0.6).all() and (ratio < 1.8).all()


@pytest.mark.parametrize(("order", "least"), [(2, 0.1), (3, 0.01)])
def test_distortion_is_seen_and_leaves_the_response_alone(order: int, least: float) -> None:
    bent = moved(sweep() + 0.3 * sweep() ** order)
    found = fit(bent, sweep())
    assert found.distortion > least  # no more of it lies within the band
    # The third power of a sine has three quarters of its square in the sine itself.
    own = 1.0 if order == 2 else 1 + 0.3 * 0.75
    np.testing.assert_allclose(found.response, own * true_response(), rtol=0.03)
