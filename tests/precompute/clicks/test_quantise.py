"""Laws of the weights that travel: within the limits, as the device makes them, hardly worse than the solved ones."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_link.protocol.basis import SAMPLE_FULL_SCALE, amplitude_steps, clamp_samples, sample_limits, weighted_sum
from precompute.clicks.click_basis import SAMPLE_RATE_HZ, click_set
from precompute.clicks.quantise import quantise
from tests.precompute.clicks.click_cases import placed, solver_of
from tests.precompute.clicks.test_closed_form import problem
from tests.precompute.devices import shipped

REFERENCE = shipped("reference-a")
SET = click_set(REFERENCE, 0.02, 1.5)


@given(st.integers(0, 2**32), st.floats(1e-3, 1.0))
def test_no_sample_passes_the_amplitude_and_the_device_clamps_none(seed: int, amplitude: float) -> None:
    weight = np.random.default_rng(seed).normal(size=len(SET.actuators))
    found = quantise(SET, weight, amplitude)
    steps = np.rint(SAMPLE_FULL_SCALE * found.waveform).astype(np.int64)
    assert abs(steps).max() <= amplitude_steps(amplitude)
    sums = weighted_sum(SET, found.words, found.fraction_bits, 2)
    limits = sample_limits([round(65_535 * amplitude)] * 2, 655_350_000, round(SAMPLE_RATE_HZ))
    np.testing.assert_array_equal(clamp_samples(sums, limits), steps.T)


@pytest.mark.parametrize("letters", ["F--q-", "q--F-", "FqFq-", "F----", "qqFqq"])
def test_rounding_takes_next_to_nothing_from_a_click(letters: str) -> None:
    given = problem("reference-a", placed(REFERENCE, letters))
    weight = given.solve()
    rounded = quantise(solver_of("reference-a").basis.sets[0], weight, REFERENCE.limits.amplitude)
    for fingers, within_db in ((given.felt, 0.02), (given.quiet, 0.05)):
        if not fingers:
            continue
        before, after = (
            20 * np.log10(given.pool.peaks(waveform, fingers))
            for waveform in (given.tones.waveform(weight), rounded.waveform)
        )
        assert np.percentile(after, [5, 95], axis=0) == pytest.approx(
            np.percentile(before, [5, 95], axis=0), abs=within_db
        )
