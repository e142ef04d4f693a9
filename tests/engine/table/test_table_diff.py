"""Laws of comparing tables: a table is its own equal, each change is found where it was made, and says how much."""

import math
from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.device import Device
from engine.table import ClickEntry, Clicks, Table
from engine.table.best_rows import BestRow, BestRows
from engine.table.levels import shifted
from engine.table.table_diff import TableDiff, Tolerance, compare_tables
from engine.touch.placement import Places
from tests.engine.made_table import basis_of, click_of, in_zones, made_clicks, row_of, write_table
from tests.engine.table.test_table import DEVICE, TEXT

LEVELS_DB = (20.0, math.inf)
STATES = (((0,), ()), ((0,), (3,)), ((1, 2), (4,)))
"""Felt and quiet zones of the clicks."""
ZONES = ((0,), (3,), (1, 2))


def rows_of(device: Device) -> list[BestRow]:
    return [row_of(device, zones, level_db) for level_db in LEVELS_DB for zones in ZONES]


def held(rows: Sequence[BestRow]) -> BestRows:
    return BestRows(rows, DEVICE.limits.amplitude)


def clicks_of(device: Device) -> list[ClickEntry]:
    basis = basis_of(len(device.actuators), 121, 133)
    return [replace(click_of(device, in_zones(device, felt, quiet)), basis=basis) for felt, quiet in STATES]


ROWS, CLICKS = rows_of(DEVICE), clicks_of(DEVICE)
STIFFER = Device.parse(TEXT.replace("18.9 kN/m", "18.711 kN/m"), "other")
Compare = Callable[..., TableDiff]


@pytest.fixture(scope="module")
def before(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Table]:
    path = write_table(tmp_path_factory.mktemp("before") / "before.nc", DEVICE, CLICKS, rows=held(ROWS))
    with Table.open(path) as table:
        yield table


@pytest.fixture
def compare(tmp_path: Path, before: Table) -> Compare:
    """A table of ROWS and CLICKS against another, which has a file only where more than those differ."""

    def compared(
        rows: Sequence[BestRow] = ROWS,
        clicks: Clicks | Sequence[ClickEntry] = CLICKS,
        device: Device = DEVICE,
        tolerance: Tolerance | None = None,
        **others: Any,
    ) -> TableDiff:
        if others or device is not DEVICE:
            with Table.open(write_table(tmp_path / "after.nc", device, clicks, rows=held(rows), **others)) as after:
                return compare_tables(before, after, tolerance)
        after = copy(before)
        after.best_rows = held(rows)
        after.clicks = clicks if isinstance(clicks, Clicks) else made_clicks(DEVICE, clicks)
        return compare_tables(before, after, tolerance)

    return compared


def with_row(index: int, **changes: Any) -> list[BestRow]:
    return [replace(row, **changes) if i == index else row for i, row in enumerate(ROWS)]


@pytest.mark.parametrize(
    ("changes", "part", "expected"),
    [
        ({"source": "measured"}, "options", {"source": "measured"}),
        ({"click_options": '{"quiet_db": 3.0}'}, "options", {"click_options.quiet_db": 3.0}),
        ({"response": 1.05}, "response_percent", {"left": pytest.approx(5.0), "right": pytest.approx(5.0)}),
        ({"others": {"measured": 1.0}}, "arrays", ("measured/number",)),  # by their bytes
        ({"device": STIFFER}, "device", {"actuator[1].stiffness_n_per_m": 18711.0}),
        ({}, "options", {}),
    ],
)
def test_what_a_table_holds_differs_by_name_but_not_who_made_it_when(
    compare: Compare, changes: dict[str, Any], part: str, expected: object
) -> None:
    made = {"created": "2025-01-01", "code_fingerprint": "0ther"}
    found = compare(**changes, **made)
    told = getattr(found, part)
    assert found.differs is bool(changes)
    assert ({change.key: change.after for change in told} if part in ("options", "device") else told) == expected
    assert not found.best_rows.differs
    assert {change.key: change.after for change in found.provenance} == made


@pytest.mark.parametrize(
    ("changes", "figure", "size"),
    [
        ({"level_db": 20.5}, "level_db", 0.5),
        ({"localized_factor": 0.6}, "localized_factor", 20.0),
        ({"achieved": False}, "achieved", 1.0),
        ({"frequencies_hz": (108.0, 190.25)}, "frequency_hz", 0.25),
        ({"amplitudes": (0.45, 0.25)}, "amplitude", 10.0),
        ({"amplitudes": (0.5, 0.0), "frequencies_hz": (108.0, 250.0)}, "amplitude", 50.0),  # silent at any frequency
    ],
)
def test_a_change_of_a_figure_is_found_where_it_was_made(
    compare: Compare, changes: dict[str, Any], figure: str, size: float
) -> None:
    found = compare(with_row(1, **changes))
    (state,) = found.best_rows.changed
    assert (state.felt, state.quiet, state.level_db) == (("IV",), (), 20.0)
    assert [change.figure for change in state.figures] == [figure]
    assert state.figures[0].size == pytest.approx(size)
    assert found.differs
    count, where, change = found.best_rows.largest()[0]
    assert (count, where, change.figure) == (1, state, figure)


@pytest.mark.parametrize(
    ("change", "figure", "size"),
    [
        (lambda c: replace(click_of(DEVICE, c.placement, level_db=27.0), basis=c.basis), "felt_level_db", 1.0),
        (lambda c: replace(c, quiet=shifted(c.quiet, 2.0)), "quiet_level_db", 2.0),
        (lambda c: replace(c, weights=c.weights + np.int16(3277)), "waveform", 10.0),
        (lambda c: replace(c, basis_set=1), "length_s", 10.0),
    ],
)
def test_a_change_of_a_click_is_found_where_it_was_made(
    compare: Compare, change: Callable[[ClickEntry], ClickEntry], figure: str, size: float
) -> None:
    found = compare(clicks=[CLICKS[0], change(CLICKS[1]), CLICKS[2]])
    (state,) = found.clicks.changed
    assert (state.felt, state.quiet, state.level_db) == (("27.9 mm",), ("195.6 mm",), None)
    assert {f.figure: f.size for f in state.figures} == {figure: pytest.approx(size, rel=1e-3)}
    assert not found.best_rows.differs


def test_states_that_vanished_and_appeared_are_named(compare: Compare) -> None:
    more = [row_of(DEVICE, (4,), level_db) for level_db in LEVELS_DB]
    found = compare([*ROWS[1:3], more[0], *ROWS[4:6], more[1]], clicks=())
    assert found.best_rows.vanished == ("felt I at 20 dB", "felt I at full scale")
    assert found.best_rows.appeared == ("felt V at 20 dB", "felt V at full scale")
    one, *others = found.clicks.vanished
    assert (one, others) == ("felt 27.9 mm", [f"{one}, quiet 195.6 mm", "felt 83.8 mm 139.7 mm, quiet 251.5 mm"])


def test_other_zones_are_matched_by_name_and_it_is_said(compare: Compare) -> None:
    four = Device.parse(TEXT.replace("count = 5", "count = 4"), "four")
    rows = [row_of(four, zones, level_db) for level_db in LEVELS_DB for zones in ZONES]
    found = compare(rows, [click_of(four, in_zones(four, *STATES[0]))], four)
    assert any("zones were I, II, III, IV, V and are I, II, III, IV:" in note for note in found.notes)
    assert any("responses" in note for note in found.notes)
    assert found.best_rows.compared == 6


def test_drives_of_other_actuators_are_not_compared_and_it_is_said(compare: Compare) -> None:
    renamed = Device.parse(TEXT.replace('name = "left"', 'name = "first"'), "renamed")
    rows = [replace(row, frequencies_hz=(70.0, 70.0)) for row in rows_of(renamed)]
    found = compare(rows, [replace(c, weights=c.weights * 0) for c in clicks_of(renamed)], renamed)
    assert any("actuators were left, right and are first, right" in note for note in found.notes)
    assert not found.best_rows.changed
    assert not found.clicks.changed


def test_clicks_for_other_places_are_not_compared_and_it_is_said(compare: Compare) -> None:
    places = Places.every(DEVICE.bar.length_m, 14e-3)
    found = compare(clicks=Clicks.of(places, CLICKS))
    assert found.notes == ("places were 27.9 mm apart and are 14 mm apart: clicks are not compared",)
    assert (found.clicks.compared, found.clicks.vanished, found.clicks.appeared) == (0, (), ())
