"""What the tests of clicks share: one small table."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from engine.table import Table
from tactable.explain.click_source import ClickSource
from tests.tactable.click_table import build_click_table


@pytest.fixture(scope="session")
def click_table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_click_table(tmp_path_factory.mktemp("clicks"))


@pytest.fixture(scope="session")
def source(click_table: Path) -> Iterator[ClickSource]:
    """For fingers as far from their positions as the table's: middles of zones are places of it."""
    with Table.open(click_table) as table:
        yield ClickSource(table, table.clicks.tolerance_m)
