"""Laws of where clicks come from, and of temporal summation: what Zwislocki's theory leaves of a burst."""

from math import inf
from pathlib import Path

import numpy as np
import pytest

from engine.table import Table, TableError
from engine.touch import Placement
from tactable.explain.click_source import ClickSource, summed_db
from tests.tactable.click_table import CHEAP, build_click_table


def test_a_click_of_the_table_is_taken_from_it_with_the_options_that_made_it(source: ClickSource) -> None:
    assert source.options == CHEAP.at(source.table.places, source.table.device.spread)
    with pytest.raises(TableError, match="--felt I"):
        source.solve(Placement.named(source.table.device, [], ["II"]))
    near = Placement.named(source.table.device, ["50 mm"], ["225 mm"])
    assert source.holds(near)
    click = source.click_of(near)
    assert click.placement.position_m == pytest.approx(Placement.named(source.table.device, ["I", "III"]).position_m)
    assert np.array_equal(click.samples, source.table.click_for(["I"], ["III"], inf).samples)


def test_a_click_that_is_solved_at_places_is_the_one_that_a_table_holds(source: ClickSource, tmp_path: Path) -> None:
    with Table.open(build_click_table(tmp_path, clicks_up_to=0)) as without:
        placement = Placement.named(without.device, ["I"], ["III"])
        empty = ClickSource(without, source.options.tolerance_m or 0.0)
        assert not empty.holds(placement)
        solved, held = empty.click_of(placement), source.click_of(placement)
    assert np.array_equal(solved.samples, held.samples)
    assert solved.felt.low_db == pytest.approx(held.felt.low_db, abs=1e-6)
    levels_db = [[finger.level_db for finger in click.fingers] for click in (solved, held)]
    assert levels_db[0] == pytest.approx(levels_db[1], abs=1e-6)
    assert (solved.exceeds_s, solved.wanted_level_db) == (held.exceeds_s, held.wanted_level_db)


RATE_HZ = 8_000.0


@pytest.mark.parametrize("length_s", [0.01, 0.03, 0.1, 0.4, 3.0])
def test_a_burst_counts_as_much_as_the_theory_says(length_s: float) -> None:
    time_s = np.arange(round(4 * RATE_HZ)) / RATE_HZ
    burst = np.where(time_s < length_s, 2.0 * np.sin(2 * np.pi * 400 * time_s), 0.0)
    theory_db = 20 * np.log10(2.0) + 10 * np.log10(1 - np.exp(-length_s / 0.2))
    assert summed_db(np.stack([burst, 10 * burst])[None], RATE_HZ)[0] == pytest.approx(
        [theory_db, theory_db + 20], abs=0.05
    )
