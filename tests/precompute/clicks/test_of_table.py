"""The options of a table's clicks."""

import json
import lzma
from pathlib import Path

import pytest

from engine.table import Table, TableError
from precompute.clicks import DEFAULT_OPTIONS
from precompute.clicks.of_table import read_click_options

PACKED = Path(__file__).parents[3] / "tables" / "ready" / "reference-d.nc.xz"


def test_options_that_are_not_known_are_refused_and_none_are_the_defaults(tmp_path: Path) -> None:
    (tmp_path / "bar.nc").write_bytes(lzma.decompress(PACKED.read_bytes()))
    with Table.open(tmp_path / "bar.nc", verify=False) as table:
        values = json.loads(table.attributes["click_options"])
        assert read_click_options(table).pitch_m == values["pitch_m"]
        table.attributes["click_options"] = json.dumps({**values, "colour": 3})
        with pytest.raises(TableError, match=r"unknown here: colour; build it again"):
            read_click_options(table)
        del table.attributes["click_options"]
        assert read_click_options(table) == DEFAULT_OPTIONS
