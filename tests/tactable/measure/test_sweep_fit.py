"""A recorded sweep or tone becomes a response beside noise, hum and harmonics, with an honest error."""

import math

import numpy as np
import pytest
from scipy import signal

from base.arrays import Array, Complex
from tactable.measure.sweep_fit import SweepFit, fit_sweep
from tactable.measure.tone_fit import fit_tone, is_beside_hum

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


TONE_RATE_HZ = 8_000.0
SECONDS = 0.4


def samples(hz: float, phasor: complex) -> Array:
    time_s = np.arange(round(SECONDS * TONE_RATE_HZ)) / TONE_RATE_HZ
    return np.asarray((phasor * np.exp(2j * np.pi * hz * time_s)).real[:, None])


@pytest.mark.parametrize("hz", [60.0, 150.0, 209.37, 299.5])
def test_a_tone_is_found_exactly_beside_offset_hum_and_harmonics(hz: float) -> None:
    values = samples(hz, 0.3 - 0.4j) + 5.0
    time_s = np.arange(len(values)) / TONE_RATE_HZ
    free = [line for line in (50, 100, 250) if abs(line - hz) > 5]
    for line in (*free, 2 * hz):
        values[:, 0] += 0.7 * np.sin(2 * np.pi * line * time_s + 1)
    fit = fit_tone(values, TONE_RATE_HZ, hz)
    assert fit.phasor[0] == pytest.approx(0.3 - 0.4j, abs=1e-6)
    assert fit.mean[0] == pytest.approx(5.0)
    assert fit.hum[0] == pytest.approx(0.7, abs=1e-6)
    assert fit.distortion[0] == pytest.approx(0.7, abs=1e-6)
    assert fit.error(0) < 1e-6


def test_a_line_of_the_mains_is_beside_the_tones_that_a_window_cannot_part_from_it() -> None:
    found = [hz for hz in range(140, 190) if is_beside_hum(hz, SECONDS)]
    assert found == [*range(148, 153), *range(178, 183)]
