"""What tests of several folders share: one small table with clicks, and an emulated firmware."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from engine.table import Table
from firmware_link.emulator.emulator_process import RunningEmulator, run_emulator
from tactable.explain.click_source import ClickSource
from tests.tactable.click_table import build_click_table
from tests.tools.once import once_a_run


@pytest.fixture(scope="session")
def click_table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return once_a_run(tmp_path_factory, "clicks", build_click_table) / "bar.nc"


@pytest.fixture(scope="session")
def table(click_table: Path) -> Iterator[Table]:
    with Table.open(click_table) as opened:
        yield opened


@pytest.fixture(scope="session")
def source(click_table: Path) -> Iterator[ClickSource]:
    """For fingers as far from their positions as the table's: middles of zones are places of it."""
    with Table.open(click_table) as table:
        yield ClickSource(table, table.clicks.tolerance_m)


@pytest.fixture
def emulator() -> Iterator[RunningEmulator]:
    """An emulated firmware behind a terminal, in a process of its own."""
    with run_emulator() as running:
        yield running
