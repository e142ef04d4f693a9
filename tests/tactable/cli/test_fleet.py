"""The command fleet: what it prints and writes, its exit status, and how it refuses."""

import csv
import json
from pathlib import Path

from tests.precompute.fleet.small_fleet import small_text, write_unit
from tests.tactable.cli.in_process import run_here


def test_a_fleet_is_built_but_for_its_bad_bar_and_again_it_keeps_what_is_done(tmp_path: Path) -> None:
    for name, stiffness in (("one", "18 kN/m"), ("two", "19 kN/m"), ("bad", "19 kg")):
        write_unit(tmp_path / "bars" / name, small_text(stiffness))
    words = ("fleet", "bars", "-o", "out", "--clicks-up-to", "0")
    done = run_here(tmp_path, *words)
    assert done.returncode == 3, done.stderr
    counted = "3 units: 2 built, 0 complete already, 1 failed"
    for part in (counted, "FAILED bad: ", "'19 kg'", "actuator[1].stiffness", "18000 (one)"):
        assert part in done.stdout
    rows = list(csv.DictReader((tmp_path / "out" / "summary.csv").read_text(encoding="utf-8").splitlines()))
    assert [(row["name"], row["status"]) for row in rows] == [("bad", "failed"), ("one", "built"), ("two", "built")]
    values = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert [unit["fingerprint"] for unit in values["units"]] == [row["fingerprint"] for row in rows]
    assert (tmp_path / "out" / "one" / "table.nc").is_file()
    again = run_here(tmp_path, *words, "--json")
    assert again.returncode == 3
    assert [unit["status"] for unit in json.loads(again.stdout)["units"]] == ["failed", "kept", "kept"]
