"""What the tests of the page share: the small table, open."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from engine.table import Table


@pytest.fixture(scope="session")
def table(click_table: Path) -> Iterator[Table]:
    with Table.open(click_table) as opened:
        yield opened
