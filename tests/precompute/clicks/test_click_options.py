"""The options of a table's clicks."""

import json
from dataclasses import asdict
from pathlib import Path

import pytest

from engine.table import Table, TableError
from precompute.clicks import DEFAULT_OPTIONS, ClickOptions
from precompute.clicks.click_options import read_click_options
from tests.engine.made_table import write_table
from tests.precompute.devices import shipped


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
