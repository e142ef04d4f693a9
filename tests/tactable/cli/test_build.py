"""The commands `build`, with its places and its clicks, `rollback` and `fleet`."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from engine.device import Device
from engine.table import Table
from engine.table.history import previous_of
from precompute.builder.table_build import build_table
from precompute.measurements.csv import write_csv
from tests.precompute.builder.test_table_build import ONE_LEVEL
from tests.precompute.fleet.small_fleet import small_text, write_unit
from tests.precompute.measurements.test_response_table import COARSE, per_newton, rows
from tests.tactable.cli.in_process import run_here, summary_of

SMALL = ONE_LEVEL.replace("count = 3", "count = 1")
SOFTER = SMALL.replace('stiffness = "1 kN/m"', 'stiffness = "0.9 kN/m"')


@pytest.mark.long
def test_what_was_solved_is_told_and_a_table_that_is_there_is_taken_over(tmp_path: Path) -> None:
    (tmp_path / "bar.toml").write_text(SMALL, encoding="utf-8")
    command = ("build", "bar.toml", "-o", "bar.nc", "--pitch", "280 mm", "--workers", "1")
    solved = []
    for _ in range(2):
        said = summary_of(tmp_path, *command)
        assert (said["clicks"], said["click_pitch_m"]) == (5, 0.2794)
        solved.append(said["clicks_solved"])
    assert solved == [2 + 5, 0]  # those of one finger come first


def test_rolled_back_is_the_table_before_unless_that_is_damaged(tmp_path: Path) -> None:
    path = tmp_path / "bar.nc"
    for text in (SMALL, SOFTER):
        build_table(Device.parse(text, "bar.toml"), path, created=str(len(text)), clicks_up_to=0)
    softer = path.read_bytes()
    assert summary_of(tmp_path, "rollback", "bar.nc")["device"] == "reference-a"
    with Table.open(path) as table:
        assert table.device.finger.stiffness_n_per_m == 1_000
    kept, before = previous_of(path), path.read_bytes()
    assert kept.read_bytes() == softer
    damaged = bytearray(softer)
    damaged[len(softer) // 2] ^= 1
    kept.write_bytes(damaged)
    done = run_here(tmp_path, "rollback", "bar.nc")
    assert done.returncode == 1 and "is corrupted" in done.stderr
    assert path.read_bytes() == before


def test_it_says_what_is_measured_and_what_is_an_estimate(tmp_path: Path) -> None:
    (tmp_path / "bar.toml").write_text(small_text(), encoding="utf-8")
    measured = rows(COARSE, np.arange(60.0, 301.0, 5.0), 22)
    (tmp_path / "bar.csv").write_text(write_csv(measured, COARSE, "SIMULATED"), encoding="utf-8")
    words = ("build", "bar.toml", "-o", "bar.nc", "--workers", "1")
    summary = summary_of(tmp_path, *words, "--responses", "bar.csv")
    with Table.open(tmp_path / "bar.nc") as table:
        assert table.attributes["responses_file"] == "bar.csv"
    assert summary["source"] == "measured responses (SIMULATED)"
    assert summary["estimates"] == len(COARSE.estimated_values)
    assert summary["model_disagreement"]["left"] < 1e-5
    assert summary_of(tmp_path, *words, "--clicks-up-to", "0")["source"] == "model"
    (tmp_path / "bar.csv").write_text(per_newton(COARSE, np.arange(60.0, 301.0, 5.0), 22), encoding="utf-8")
    scaled = run_here(tmp_path, *words, "--responses", "bar.csv", "--force-of-actuators")
    assert scaled.returncode == 0, scaled.stderr
    for part in ("0 clicks", "measured responses in bar.csv", "ESTIMATE", "there are no clicks"):
        assert part in scaled.stdout
    assert "Levels rest on the full scale of the device file" in scaled.stdout
    assert "--responses" in run_here(tmp_path, *words, "--force-of-actuators").stderr


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
