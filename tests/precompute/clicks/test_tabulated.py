"""Laws of tabulated clicks: every placement of up to two fingers that can come, each once; of their options."""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from engine.table import Table, TableError
from engine.touch import Placement
from engine.touch.placement import CLOSEST_M, Places
from precompute.clicks import DEFAULT_OPTIONS, ClickOptions
from precompute.clicks.click_options import read_click_options
from precompute.clicks.tabulated import tabulate_clicks, tabulated_keys
from tests.engine.made_table import write_table
from tests.precompute.clicks.click_cases import CHEAP
from tests.precompute.devices import shipped

LENGTH_M = 0.2794


@given(
    st.sampled_from([3e-3, 8e-3, 12e-3, 28e-3]),
    st.lists(st.tuples(st.floats(0, LENGTH_M), st.booleans()), min_size=1, max_size=2),
)
def test_whatever_one_or_two_fingers_come_their_placement_is_tabulated(
    pitch_m: float, fingers: list[tuple[float, bool]]
) -> None:
    places, fingers = Places.every(LENGTH_M, pitch_m), sorted(fingers)
    position_m, is_felt = zip(*fingers, strict=True)
    key = places.key(Placement(position_m, is_felt))
    are_apart = len(fingers) < 2 or position_m[1] - position_m[0] >= CLOSEST_M
    are_at_two_places = len({code // 2 for code in key}) == len(fingers)
    if any(is_felt) and are_apart and are_at_two_places:
        assert key in set(tabulated_keys(places, 2))


@pytest.mark.machine(stall_s=None)
def test_clicks_are_the_same_by_however_many_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    for few in ("_PAYS", "_TOGETHER"):  # each of these four clicks for itself
        monkeypatch.setattr(f"precompute.clicks.tabulated.{few}", 1)
    device, places = shipped("reference-a"), Places(LENGTH_M, 6)
    keys = [(2, 7), (3, 6), (3, 7), (5,)]
    one, two = (
        {places.key(click.placement): click for click in tabulate_clicks(device, CHEAP, places, keys, n)}
        for n in (1, 2)
    )
    assert set(one) == set(two) == set(keys)
    for key, click in one.items():
        assert np.array_equal(click.weights, two[key].weights) and click.felt == two[key].felt
        assert click.tolerance_m == places.pitch_m / 2 + 1e-3


def test_options_are_read_unknown_ones_refused_and_none_are_the_defaults(tmp_path: Path) -> None:
    options = ClickOptions(quiet_db=1.0, tolerance_m=2e-3)
    path = write_table(tmp_path / "bar.nc", shipped("reference-a"), click_options=json.dumps(asdict(options)))
    with Table.open(path, verify=False) as table:
        assert read_click_options(table) == options
        table.attributes["click_options"] = json.dumps({**asdict(options), "colour": 3})
        with pytest.raises(TableError, match=r"unknown here: colour; build it again"):
            read_click_options(table)
        del table.attributes["click_options"]
        assert read_click_options(table) == DEFAULT_OPTIONS
