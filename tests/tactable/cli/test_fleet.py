"""The command fleet: what it prints and writes, its exit status, and how it refuses."""

import csv
import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tactable.cli.main import app
from tests.precompute.fleet.small_fleet import small_text, write_unit


def fleet(*words: str | Path) -> tuple[int, str]:
    done = CliRunner().invoke(app, ["fleet", *map(str, words)])
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    return done.exit_code, done.stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two good bars and a bad one, done."""
    folder = tmp_path_factory.mktemp("fleet")
    for name, stiffness in (("one", "18 kN/m"), ("two", "19 kN/m"), ("bad", "19 kg")):
        write_unit(folder / "bars" / name, small_text(stiffness))
    status, out = fleet(folder / "bars", "-o", folder / "out", "--clicks-up-to", "0")
    assert status == 3
    (folder / "page.txt").write_text(out, encoding="utf-8")
    return folder


def test_the_page_says_how_many_what_failed_and_what_varies(folder: Path) -> None:
    page = (folder / "page.txt").read_text(encoding="utf-8")
    assert "3 units: 2 built, 0 complete already, 1 failed" in page
    assert "FAILED bad: " in page
    assert "'19 kg'" in page
    assert "actuator[1].stiffness" in page
    assert "18000 (one)" in page


def test_the_summary_is_written_as_csv_and_json(folder: Path) -> None:
    rows = list(csv.DictReader((folder / "out" / "summary.csv").read_text(encoding="utf-8").splitlines()))
    assert [(row["name"], row["status"]) for row in rows] == [("bad", "failed"), ("one", "built"), ("two", "built")]
    values = json.loads((folder / "out" / "summary.json").read_text(encoding="utf-8"))
    assert [unit["fingerprint"] for unit in values["units"]] == [row["fingerprint"] for row in rows]
    assert (folder / "out" / "one" / "table.nc").is_file()


def test_again_it_keeps_what_is_done_and_json_says_so(folder: Path) -> None:
    status, out = fleet(folder / "bars", "-o", folder / "out", "--clicks-up-to", "0", "--json")
    assert status == 3
    assert [unit["status"] for unit in json.loads(out)["units"]] == ["failed", "kept", "kept"]
