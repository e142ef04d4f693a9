"""Laws of the weights that travel: within the limits, as the device makes them, hardly worse than the solved ones."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_link.protocol.basis import SAMPLE_FULL_SCALE, amplitude_steps, clamp_samples, sample_limits, weighted_sum
from precompute.clicks.basis import SAMPLE_RATE_HZ, click_basis, click_set, tones_of
from precompute.clicks.design import Designer
from precompute.clicks.evaluation import evaluate_waveform
from precompute.clicks.options import ClickOptions
from precompute.clicks.quantise import quantise
from precompute.clicks.solver import ClickSolver
from tests.precompute.clicks.click_cases import CHEAP, placed
from tests.precompute.devices import every_device, shipped

REFERENCE = shipped("reference-a")
SET = click_set(REFERENCE, 0.02, 1.5)


@given(st.integers(0, 2**32), st.floats(1e-3, 1.0), st.sampled_from([None, 200.0, 1000.0]))
def test_no_sample_passes_amplitude_or_slew_and_the_device_clamps_none(
    seed: int, amplitude: float, slew_per_s: float | None
) -> None:
    weight = np.random.default_rng(seed).normal(size=len(SET.actuators))
    found = quantise(SET, weight, amplitude, slew_per_s)
    steps = np.rint(SAMPLE_FULL_SCALE * found.waveform).astype(np.int64)
    assert abs(steps).max() <= amplitude_steps(amplitude)
    if slew_per_s is not None:
        assert abs(np.diff(found.waveform, axis=1)).max() <= slew_per_s / SAMPLE_RATE_HZ + 1e-12
    sums = weighted_sum(SET, found.words, found.fraction_bits, 2)
    limits = sample_limits([round(65_535 * amplitude)] * 2, 655_350_000, round(SAMPLE_RATE_HZ))
    np.testing.assert_array_equal(clamp_samples(sums, limits), steps.T)


@given(st.integers(0, 2**32))
def test_weights_within_the_limits_are_only_rounded(seed: int) -> None:
    weight = np.random.default_rng(seed).normal(size=len(SET.actuators))
    weight *= 0.9 / abs(tones_of(SET).waveform(weight)).max()
    found = quantise(SET, weight, 1.0, None)
    assert abs(found.words / 2**found.fraction_bits - weight).max() <= 0.5 / 2**found.fraction_bits
    assert abs(found.waveform - tones_of(SET).waveform(weight)).max() <= 1e-3


@pytest.mark.parametrize("letters", ["F--q-", "q--F-", "FqFq-", "F----", "qqFqq"])
def test_rounding_takes_next_to_nothing_from_a_click(letters: str) -> None:
    solver, placement = ClickSolver(REFERENCE, CHEAP), placed(REFERENCE, letters)
    plants = solver.plants_of(placement.position_m)
    designer = Designer(REFERENCE, CHEAP, plants, placement, CHEAP.lengths_s[0])
    design = designer.design()
    assert design.weight is not None
    rounded = quantise(designer.basis_set, design.weight, REFERENCE.limits.amplitude, None)
    before, after = (
        evaluate_waveform(waveform, plants.evaluated, designer.felt, designer.quiet, 0.05)
        for waveform in (design.waveform, rounded.waveform)
    )
    assert after.felt.low_db == pytest.approx(before.felt.low_db, abs=0.02)
    if before.quiet is not None and after.quiet is not None:
        assert after.quiet.high_db == pytest.approx(before.quiet.high_db, abs=0.05)


@pytest.mark.parametrize("device", every_device().values(), ids=every_device())
def test_a_basis_has_a_set_for_each_length_with_peaks_at_full_scale(device: object) -> None:
    options = ClickOptions(lengths_s=(0.01, 0.02))
    basis = click_basis(device, options)  # type: ignore[arg-type]  # a parameter of a test
    assert [(each.samples - 1) / basis.sample_rate_hz for each in basis.sets] == [0.01, 0.02]
    for each in basis.sets:
        assert (abs(each.functions).max(axis=1) == SAMPLE_FULL_SCALE).all()
        assert sorted(set(each.actuators.tolist())) == list(range(len(device.actuators)))  # type: ignore[attr-defined]
