"""Laws of solved clicks: on the grid of the wire, at rest at both ends, mirrored with the bar, the same each time."""

import numpy as np
import pytest

from precompute.clicks.click_basis import SAMPLE_RATE_HZ
from precompute.clicks.click_solver import FULL_SCALE
from tests.precompute.clicks.click_cases import CHEAP, placed, solver_of

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
    assert entry.tolerance_m == solver.device.spread.finger_position_m
    assert entry.achieved and list(entry.exceeds_s) == [*solver.device.levels_db, np.inf]
