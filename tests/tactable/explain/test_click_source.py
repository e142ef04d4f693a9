"""Laws of where clicks come from: the table, or the same click solved when it is asked for."""

import json
from pathlib import Path

import numpy as np
import pytest

from engine.table import Table, TableError
from precompute.clicks import DEFAULT_OPTIONS
from tactable.explain.click_source import ClickSource, read_click_options
from tests.tactable.click_table import CHEAP, build_click_table


def test_the_options_are_those_that_the_table_was_made_with(source: ClickSource) -> None:
    assert source.options == CHEAP


def test_a_click_of_the_table_is_taken_from_it(source: ClickSource) -> None:
    states = source.table.states_of(["I"], ["III"])
    assert source.holds(states)
    assert any(source.solve_click(states).weights is click.weights for click in source.table.clicks)


def test_a_click_that_is_asked_for_is_the_one_that_a_table_holds(source: ClickSource, tmp_path: Path) -> None:
    with Table.open(build_click_table(tmp_path, clicks_up_to=0)) as without:
        states = without.states_of(["I"], ["III"])
        empty = ClickSource(without)
        assert not empty.holds(states)
        solved, held = empty.solve_click(states), source.solve_click(states)
    assert np.array_equal(solved.samples, held.samples)
    assert (solved.felt, solved.quiet, solved.zones) == (held.felt, held.quiet, held.zones)
    assert (solved.exceeds_s, solved.wanted_level_db) == (held.exceeds_s, held.wanted_level_db)


def test_a_state_without_a_felt_finger_is_refused(source: ClickSource) -> None:
    with pytest.raises(TableError, match="--felt I"):
        source.solve_click(source.table.states_of([], ["II"]))


def test_options_that_are_not_known_are_refused_and_none_are_the_defaults(click_table: Path) -> None:
    with Table.open(click_table) as table:
        values = json.loads(table.attributes["click_options"])
        table.attributes["click_options"] = json.dumps({**values, "colour": 3})
        with pytest.raises(TableError, match=r"unknown here: colour; build it again"):
            read_click_options(table)
        del table.attributes["click_options"]
        assert read_click_options(table) == DEFAULT_OPTIONS
