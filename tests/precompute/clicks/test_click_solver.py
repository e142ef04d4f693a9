"""Laws of solved clicks: on the grid of the wire, at rest at both ends, mirrored with the bar, the same each time."""

import numpy as np
import pytest

from precompute.clicks.click_basis import SAMPLE_RATE_HZ
from precompute.clicks.click_solver import FULL_SCALE, ClickSolver
from precompute.clicks.closed_form import OF_ROWS
from tests.precompute.clicks.click_cases import CHEAP, placed, solver_of
from tests.precompute.devices import mirrored, shipped

any_case = pytest.mark.parametrize("letters", ["F--q-", "FqFq-", "F----", "qqFqq"])


@any_case
def test_an_entry_is_the_click_on_the_grid_of_the_wire_at_rest_at_both_ends_with_its_figures(letters: str) -> None:
    solver = solver_of("reference-a")
    placement = placed(solver.device, letters)
    click, entry = solver.solve(placement), solver.solve_entry(placement)
    steps, figures = click.waveform * FULL_SCALE, click.evaluation
    assert abs(click.waveform).max() <= solver.device.limits.amplitude
    assert steps == pytest.approx(np.round(steps), abs=1e-9) and not steps[:, [0, -1]].any()
    assert steps.shape[1] == round(CHEAP.length_s * SAMPLE_RATE_HZ) + 1
    np.testing.assert_array_equal(entry.samples.T, np.round(steps))
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
    assert there.evaluation.felt.nominal_db == pytest.approx(here.evaluation.felt.nominal_db, abs=0.1)
    sign = np.sign((there.waveform * here.waveform).sum())
    assert abs(sign * there.waveform - here.waveform).max() <= 0.05
