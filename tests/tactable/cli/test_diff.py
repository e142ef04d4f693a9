"""The command diff: its exit status, what it prints for people, what for machines."""

from dataclasses import replace

import pytest
from typer.testing import CliRunner

from tactable.cli.main import app
from tests.engine.made_table import write_table
from tests.engine.table.test_table import DEVICE
from tests.engine.table.test_table_diff import CLICKS, held, rows_of

ROWS = rows_of(DEVICE)


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    folder = tmp_path_factory.mktemp("tables")
    before = write_table(folder / "before.nc", DEVICE, CLICKS, rows=held(ROWS))
    rows = held([ROWS[0], replace(ROWS[1], level_db=18.5), *ROWS[2:]])
    after = write_table(folder / "after.nc", DEVICE, CLICKS[:2], rows=rows, source="measured")
    return str(before), str(after)


def diff(*words: str) -> tuple[int, str, str]:
    done = CliRunner().invoke(app, ["diff", *words])
    return done.exit_code, done.stdout, done.stderr


def test_the_status_is_0_for_the_same_1_for_others_and_2_for_trouble(tables: tuple[str, str]) -> None:
    before, after = tables
    assert diff(before, before)[0] == 0
    assert diff(before, after)[0] == 1
    for words in ((before, "no-such.nc"), (before, __file__), (before,), (before, after, "--limit", "-1")):
        assert diff(*words)[0] == 2, words
    _, out, errors = diff(before, "no-such.nc")
    assert not out
    assert errors.startswith("tactable: no-such.nc: ")
    assert errors.count("\n") == 1


def test_words_and_figures_say_what_changed(tables: tuple[str, str]) -> None:
    out = diff(*tables)[1]
    for part in ("the tables differ", "option: source: measured appeared", "felt IV at 20 dB: level 20 -> 18.5 dB"):
        assert part in out
    assert "best rows: 1 of 6 changed beyond 0.1 dB" in out and "clicks: none of 2 changed" in out
    assert "clicks: 1 vanished: felt 83.8 mm 139.7 mm, quiet 251.5 mm" in out
    out = diff(tables[0], tables[0])[1]
    assert "the tables are the same" in out and "best rows: none of 6 changed" in out
    assert "best rows: none of 6 changed" in diff(*tables, "--limit", "1.6")[1]
