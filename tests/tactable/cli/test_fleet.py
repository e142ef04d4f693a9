"""The command fleet: what it prints and writes, its exit status, and how it refuses."""

import csv
import json
from pathlib import Path

from typer.testing import CliRunner

from tactable.cli.main import app
from tests.precompute.fleet.small_fleet import small_text, write_unit


def fleet(*words: str | Path) -> tuple[int, str]:
    done = CliRunner().invoke(app, ["fleet", *map(str, words)])
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    return done.exit_code, done.stdout


def test_a_fleet_is_built_but_for_its_bad_bar_and_again_it_keeps_what_is_done(tmp_path: Path) -> None:
    for name, stiffness in (("one", "18 kN/m"), ("two", "19 kN/m"), ("bad", "19 kg")):
        write_unit(tmp_path / "bars" / name, small_text(stiffness))
    words = (tmp_path / "bars", "-o", tmp_path / "out", "--clicks-up-to", "0")
    status, page = fleet(*words)
    assert status == 3
    counted = "3 units: 2 built, 0 complete already, 1 failed"
    for part in (counted, "FAILED bad: ", "'19 kg'", "actuator[1].stiffness", "18000 (one)"):
        assert part in page
    rows = list(csv.DictReader((tmp_path / "out" / "summary.csv").read_text(encoding="utf-8").splitlines()))
    assert [(row["name"], row["status"]) for row in rows] == [("bad", "failed"), ("one", "built"), ("two", "built")]
    values = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert [unit["fingerprint"] for unit in values["units"]] == [row["fingerprint"] for row in rows]
    assert (tmp_path / "out" / "one" / "table.nc").is_file()
    status, out = fleet(*words, "--json")
    assert status == 3
    assert [unit["status"] for unit in json.loads(out)["units"]] == ["failed", "kept", "kept"]
