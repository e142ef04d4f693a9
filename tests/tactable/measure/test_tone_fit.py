"""A tone in a window of samples: found beside hum, offset and harmonics, with its error and the drift of the clock."""

import numpy as np
import pytest
from numpy.typing import NDArray

from tactable.measure.tone_fit import ToneFit, fit_tone, is_beside_hum

RATE_HZ = 8_000.0
SECONDS = 0.4


def samples(hz: float, *phasors: complex, noise: float = 0.0, drift: float = 0.0) -> NDArray[np.float64]:
    """A channel for each phasor, by a converter whose clock is fast by `drift`."""
    time_s = np.arange(round(SECONDS * RATE_HZ)) / (RATE_HZ * (1 + drift))
    tone = np.exp(2j * np.pi * hz * time_s)
    random = np.random.default_rng(0)
    columns = [(phasor * tone).real + noise * random.standard_normal(len(tone)) for phasor in phasors]
    return np.array(columns).T


def fitted(values: NDArray[np.float64], hz: float) -> ToneFit:
    return fit_tone(values, RATE_HZ, hz)


@pytest.mark.parametrize("hz", [60.0, 150.0, 209.37, 299.5])
def test_a_tone_is_found_exactly_beside_offset_hum_and_harmonics(hz: float) -> None:
    values = samples(hz, 0.3 - 0.4j) + 5.0
    time_s = np.arange(len(values)) / RATE_HZ
    free = [line for line in (50, 100, 250) if abs(line - hz) > 5]
    for line in (*free, 2 * hz):
        values[:, 0] += 0.7 * np.sin(2 * np.pi * line * time_s + 1)
    fit = fitted(values, hz)
    assert fit.phasor[0] == pytest.approx(0.3 - 0.4j, abs=1e-6)
    assert fit.mean[0] == pytest.approx(5.0)
    assert fit.hum[0] == pytest.approx(0.7, abs=1e-6)
    assert fit.distortion[0] == pytest.approx(0.7, abs=1e-6)
    assert fit.error(0) < 1e-6


def test_the_ratio_of_two_channels_has_no_latency_in_it() -> None:
    late = np.exp(-2j * np.pi * 150 * 0.0123)
    fit = fitted(samples(150, 2j * late, 0.1 * late), 150)
    assert fit.ratio(0, 1) == pytest.approx(20j)
    assert fit.coherence(0, 1) == pytest.approx(1)


def test_noise_is_the_error_that_is_stated() -> None:
    phasor, errors, stated = 1.0 + 0j, [], []
    random = np.random.default_rng(3)
    clean = samples(150, phasor)
    for _ in range(200):
        fit = fitted(clean + 0.5 * random.standard_normal(clean.shape), 150)
        errors.append(abs(fit.phasor[0] - phasor))
        stated.append(fit.error(0))
    assert np.sqrt(np.mean(np.square(stated))) == pytest.approx(np.sqrt(np.mean(np.square(errors))), rel=0.1)


@pytest.mark.parametrize("drift", [40e-6, -150e-6])
def test_the_drift_of_the_clock_is_the_slope_of_the_phase(drift: float) -> None:
    assert fitted(samples(250, 1, drift=drift), 250).drift(0) == pytest.approx(drift, rel=0.03)


def test_lost_samples_are_a_step_of_the_phase() -> None:
    values = samples(150, 1)
    whole = fitted(values, 150).phase_step_rad(0)
    cut = fitted(np.delete(values, slice(1000, 1020), axis=0), 150).phase_step_rad(0)
    assert whole < 1e-6 < 0.2 < cut


def test_a_line_of_the_mains_is_beside_the_tones_that_a_window_cannot_part_from_it() -> None:
    assert [hz for hz in range(140, 190) if is_beside_hum(hz, SECONDS)] == [
        *range(148, 153),
        *range(178, 183),
    ]
