"""Laws of states on demand: they are the solver's, and kept."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from engine.device import Device
from engine.table import Table
from engine.touch import ZoneState
from precompute.builder import on_demand
from precompute.builder.build import build_table
from precompute.builder.on_demand import entries_on_demand
from precompute.entries.prediction import touched_zones
from precompute.entries.solver import MOST_TOUCHED_BEYOND, tabulated_states
from tests.precompute.devices import SHIPPED, shipped, with_zones

NINE = (
    (SHIPPED / "reference-a.toml")
    .read_text(encoding="utf-8")
    .replace("count = 5", "count = 9")
    .replace('step = "1 Hz"', 'step = "40 Hz"')
    .replace("amplitude_steps = 5", "amplitude_steps = 1")
)


@pytest.mark.parametrize("count", [1, 2, 5, 8])
def test_every_state_with_a_felt_zone_is_tabulated_up_to_eight_zones(count: int) -> None:
    states = tabulated_states(with_zones(shipped("reference-a"), count))
    assert len(set(states)) == len(states) == 3**count - 2**count


def test_beyond_eight_zones_states_of_few_fingers_are_tabulated() -> None:
    states = tabulated_states(with_zones(shipped("reference-a"), 10))
    assert max(len(touched_zones(state)) for state in states) == MOST_TOUCHED_BEYOND
    assert len(states) == 10 * 1 + 45 * 3 + 120 * 7


def test_a_state_that_no_table_holds_is_solved_once_and_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    device = replace(Device.parse(NINE, "nine"), levels_db=(20.0,))
    monkeypatch.setattr("precompute.entries.solver.MOST_TOUCHED_BEYOND", 1)  # a small table
    text = NINE.replace('levels = ["10 dB", "20 dB", "30 dB"]', 'levels = ["20 dB"]')
    build_table(Device.parse(text, "nine"), tmp_path / "nine.nc", created="2026-01-01", clicks_up_to=0)
    states = (ZoneState.FELT, ZoneState.QUIET, *(ZoneState.FREE,) * 7)
    with Table.open(tmp_path / "nine.nc") as table:
        solved = entries_on_demand(table, states, tmp_path / "kept")
        (kept,) = (tmp_path / "kept").iterdir()
        monkeypatch.setattr(on_demand, "EntrySolver", None)  # not solved again
        assert entries_on_demand(table, states, tmp_path / "kept") == solved
        assert kept.suffix == ".json"
    assert [entry.wanted_level_db for entry in solved] == [*device.levels_db, np.inf]
    assert all(entry.states == states for entry in solved)
