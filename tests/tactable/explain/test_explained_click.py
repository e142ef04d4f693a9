"""Laws of the page about a click: what the table promises, where the click came from, and temporal summation."""

import json
from dataclasses import astuple, replace
from io import StringIO
from math import inf
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from engine.table import Table, TableError
from engine.touch import Placement
from tactable.explain.click_source import ClickSource, summed_db
from tactable.explain.explained_click import Explained, click_json, explain_click, print_click
from tests.tactable.click_table import CHEAP, build_click_table, placed


def explained_of(source: ClickSource, felt: str, quiet: str, level_db: float = inf) -> Explained:
    return explain_click(source, placed(source, felt, quiet), level_db)


def page_of(source: ClickSource, explained: Explained) -> str:
    page = StringIO()
    print_click(Console(file=page, width=80), source.table, explained)
    return page.getvalue()


def test_the_values_are_the_table_s(source: ClickSource) -> None:
    explained = explained_of(source, "I", "III")
    values, click = click_json(source.table, explained), source.table.click_for(["I"], ["III"], inf)
    assert json.loads(json.dumps(values, allow_nan=False)) == values
    assert click.quiet is not None
    assert values["felt_db"] == dict(zip(("nominal", "5 %", "50 %", "95 %"), astuple(click.felt)[:4], strict=True))
    assert values["quiet_db"]["95 %"] == click.quiet.high_db
    assert values["wanted_level_db"] is None
    assert (values["felt_zones"], values["quiet_zones"]) == (["I"], ["III"])
    assert values["exceeds_s"] == click.exceeds_s[inf]
    assert values["options"]["judged"] == 20


def test_the_table_s_own_click_is_judged_under_the_same_fingers(source: ClickSource) -> None:
    """At a place of the table it is the same click; elsewhere it is weaker, or less quiet."""
    at_place = explained_of(source, "I", "III")
    own = at_place.tabulated
    assert own is not None and own.click.placement.position_m == pytest.approx(at_place.placement.position_m)
    assert own.finger_db == pytest.approx(at_place.finger_db)
    elsewhere = Placement.named(source.table.device, ["60 mm"], ["215 mm"])
    beside = explain_click(ClickSource(source.table), elsewhere, inf)
    values = click_json(source.table, beside)
    assert values["table"]["places_m"] == pytest.approx(at_place.placement.position_m)
    assert values["table"]["tolerance_m"] == pytest.approx(source.table.clicks.tolerance_m)
    here, tables = (values["fingers"], values["table"]["fingers"])
    assert [finger["position_m"] for finger in tables] == [finger["position_m"] for finger in here] == [0.06, 0.215]
    lost_db = here[0]["level_db"]["5 %"] - tables[0]["level_db"]["5 %"]
    gained_db = tables[1]["level_db"]["95 %"] - here[1]["level_db"]["95 %"]
    assert max(lost_db, gained_db) > 3


def test_fingers_that_the_table_does_not_hold_are_said(source: ClickSource) -> None:
    explained = explained_of(source, "I", "II III")
    assert explained.tabulated is None
    assert click_json(source.table, explained)["table"] is None
    assert "the table has no click for these fingers" in page_of(source, explained)
    assert "the table plays its click of 46.57 mm (I) felt" in page_of(source, explained_of(source, "I", "III"))


def test_the_page_names_the_promise_what_is_missed_and_what_is_not_known(source: ClickSource) -> None:
    explained = explained_of(source, "I", "III")
    click, device = explained.click, source.table.device
    passed_s = click.exceeds_s[inf]
    assert click.quiet is not None and passed_s is not None
    never = replace(click, exceeds_s={10.0: None, inf: None})
    options = replace(source.options, length_s=0.05, crowding=2.0)
    promise = (f"{click.felt.low_db:z.1f} dB", f"{click.quiet.high_db:z.1f} dB", f"{1e3 * passed_s:.1f} ms")
    made = (f"{1e3 * click.peak_s:.1f} ms", "with 90 plants", "on 20 others")
    estimates = f"{len(device.estimated_values)} values are ESTIMATES"
    for case, parts in (
        (explained, (*promise, *made, estimates, device.threshold.title, "temporal summation")),
        (explained_of(source, "I", "III", 60.0), ("60 dB wanted", "NOT ACHIEVED")),
        (explained_of(source, "I", "III", 1.0), ("not known below 10 dB",)),
        (replace(explained, click=never), ("never by a felt finger",)),
        (replace(explained, options=options), ("50 ms", "0.5/length")),
    ):
        page = page_of(source, case)
        assert all(part in page for part in parts), parts
        assert max(len(line) for line in page.splitlines() if line[:1] in "┏┃┡│└") <= 80


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
