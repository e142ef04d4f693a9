"""Laws of solved clicks: on the grid of the wire, at rest at both ends, mirrored with the bar, the same each time."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_link.protocol.basis import SAMPLE_FULL_SCALE, amplitude_steps, clamp_samples, sample_limits, weighted_sum
from precompute.clicks.click_basis import SAMPLE_RATE_HZ, click_set
from precompute.clicks.click_solver import ClickSolver, quantise
from precompute.clicks.closed_form import OF_ROWS
from tests.precompute.clicks.click_cases import CHEAP, placed, solver_of
from tests.precompute.clicks.test_closed_form import problem
from tests.precompute.devices import mirrored, shipped

any_case = pytest.mark.parametrize("letters", ["F--q-", "FqFq-", "F----", "qqFqq"])
REFERENCE = shipped("reference-a")
SET = click_set(REFERENCE, 0.02, 1.5)


@any_case
def test_an_entry_is_the_click_on_the_grid_of_the_wire_at_rest_at_both_ends_with_its_figures(letters: str) -> None:
    solver = solver_of("reference-a")
    placement = placed(solver.device, letters)
    entry = solver.solve(placement)
    figures = solver.evaluate(placement, entry.waveform.T)
    assert abs(entry.waveform).max() <= solver.device.limits.amplitude
    assert len(entry.samples) == round(CHEAP.length_s * SAMPLE_RATE_HZ) + 1 and not entry.samples[[0, -1]].any()
    assert (entry.felt, entry.quiet, entry.fingers) == (figures.felt, figures.quiet, figures.fingers)
    assert entry.tolerance_m == solver.device.spread.reach_m
    assert entry.achieved and list(entry.exceeds_s) == [*solver.device.levels_db, np.inf]


def test_an_order_of_placements_changes_no_click() -> None:
    """Neighbours share plants, which are kept; a click depends on nothing but its placement."""
    device = shipped("reference-a")
    first, second = placed(device, "F--q-"), placed(device, "q--F-")
    one, other = ClickSolver(device, CHEAP), ClickSolver(device, CHEAP)
    forth = [one.solve(each).waveform for each in (first, second)]
    back = [other.solve(each).waveform for each in (second, first)]
    assert all((a == b).all() for a, b in zip(forth, back[::-1], strict=True))


def test_for_more_fingers_fewer_plants_trim_and_judge() -> None:
    solver = solver_of("reference-a")
    for fingers, part in ((1, 1), (3, 1), (4, 2), (7, 3)):
        plants = solver.plants_of(tuple(np.linspace(0.02, 0.25, fingers).tolist()))
        trimming, judging = len(plants.pool.transfer) - OF_ROWS, len(plants.judged.transfer) - 1
        assert (trimming, judging) == ((1 + CHEAP.pool - OF_ROWS) // part, CHEAP.judged // part)


@pytest.mark.parametrize("letters", ["F--q-", "qqFqq", "F----"])
def test_a_mirrored_bar_gets_mirrored_clicks_of_one_felt_finger(letters: str) -> None:
    """The same waveforms, up to their sign. Instants of several felt fingers are chosen in the order along the bar."""
    device = shipped("reference-a")
    here = solver_of("reference-a").solve(placed(device, letters))
    there = ClickSolver(mirrored(device), CHEAP).solve(placed(mirrored(device), letters[::-1]))
    assert there.felt.nominal_db == pytest.approx(here.felt.nominal_db, abs=0.1)
    sign = np.sign((there.waveform * here.waveform).sum())
    assert abs(sign * there.waveform - here.waveform).max() <= 0.05


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
