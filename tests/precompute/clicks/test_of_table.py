"""The options of a table's clicks."""

import json
from pathlib import Path

import pytest

from engine.table import Table, TableError
from precompute.clicks import DEFAULT_OPTIONS
from precompute.clicks.of_table import read_click_options


def test_options_that_are_not_known_are_refused_and_none_are_the_defaults(click_table: Path) -> None:
    with Table.open(click_table) as table:
        values = json.loads(table.attributes["click_options"])
        table.attributes["click_options"] = json.dumps({**values, "colour": 3})
        with pytest.raises(TableError, match=r"unknown here: colour; build it again"):
            read_click_options(table)
        del table.attributes["click_options"]
        assert read_click_options(table) == DEFAULT_OPTIONS
