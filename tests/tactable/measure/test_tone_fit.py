"""A tone in a window of samples: found beside hum, offset and harmonics, with its error."""

import numpy as np
import pytest

from base.arrays import Array
from tactable.measure.tone_fit import fit_tone, is_beside_hum

RATE_HZ = 8_000.0
SECONDS = 0.4


def samples(hz: float, phasor: complex) -> Array:
    time_s = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    return np.asarray((phasor * np.exp(2j * np.pi * hz * time_s)).real[:, None])


@pytest.mark.parametrize("hz", [60.0, 150.0, 209.37, 299.5])
def test_a_tone_is_found_exactly_beside_offset_hum_and_harmonics(hz: float) -> None:
    values = samples(hz, 0.3 - 0.4j) + 5.0
    time_s = np.arange(len(values)) / RATE_HZ
    free = [line for line in (50, 100, 250) if abs(line - hz) > 5]
    for line in (*free, 2 * hz):
        values[:, 0] += 0.7 * np.sin(2 * np.pi * line * time_s + 1)
    fit = fit_tone(values, RATE_HZ, hz)
    assert fit.phasor[0] == pytest.approx(0.3 - 0.4j, abs=1e-6)
    assert fit.mean[0] == pytest.approx(5.0)
    assert fit.hum[0] == pytest.approx(0.7, abs=1e-6)
    assert fit.distortion[0] == pytest.approx(0.7, abs=1e-6)
    assert fit.error(0) < 1e-6


def test_a_line_of_the_mains_is_beside_the_tones_that_a_window_cannot_part_from_it() -> None:
    found = [hz for hz in range(140, 190) if is_beside_hum(hz, SECONDS)]
    assert found == [*range(148, 153), *range(178, 183)]
