"""Entries in a file: spreads come back as they were, levels move with the amplitude, older tables state none."""

from dataclasses import replace
from pathlib import Path

import h5netcdf
import pytest

from engine.table import Entry, Table
from engine.table.entry import EntrySpread, Percentiles, scaled_to
from tests.engine.made_entries import entry_of, states_of
from tests.engine.made_table import write_table
from tests.engine.table.test_table import DEVICE

SPREAD = EntrySpread(Percentiles(15.0, 19.0, 22.0), Percentiles(1.0, 6.5, 9.0), Percentiles(8.0, 12.0, 18.0))
ALL_FELT = EntrySpread(SPREAD.felt, None, None)
ENTRIES = [
    replace(entry_of(DEVICE, states_of(DEVICE, [0], [2])), spread=SPREAD, reached_db=15.0),
    replace(entry_of(DEVICE, states_of(DEVICE, [0, 1])), spread=ALL_FELT, reached_db=20.0),
]


def read(path: Path) -> tuple[Entry, ...]:
    with Table.open(path) as table:
        return table.entries


def test_spreads_are_read_back_as_written(tmp_path: Path) -> None:
    path = write_table(tmp_path / "t.nc", DEVICE, ENTRIES)
    assert list(read(path)) == ENTRIES
    with h5netcdf.File(path, "r", decode_vlen_strings=True) as file:
        assert list(file["entries"].variables["spread"][...]) == ["5 %", "50 %", "95 %"]


def test_entries_without_spreads_are_read_back_without(tmp_path: Path) -> None:
    plain = [replace(entry, spread=None) for entry in ENTRIES]
    path = write_table(tmp_path / "t.nc", DEVICE, plain)
    assert list(read(path)) == plain


def test_an_entry_is_played_by_what_counts_as_its_level() -> None:
    softer = scaled_to(ENTRIES[0], 12.0)
    assert softer.reached_db == pytest.approx(12.0) and softer.level_db == pytest.approx(ENTRIES[0].level_db - 3.0)
    assert softer.achieved and softer.spread is not None and softer.spread.quiet is not None
    assert softer.spread.felt == Percentiles(12.0, 16.0, 19.0)
    assert softer.spread.quiet.low_db == pytest.approx(-2.0) and softer.spread.contrast == SPREAD.contrast
