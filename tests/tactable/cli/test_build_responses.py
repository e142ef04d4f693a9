"""The command build with measured responses: what it builds, what it says of it, how it refuses."""

from pathlib import Path

import numpy as np

from engine.table import Table
from precompute.measurements.csv import write_csv
from tests.precompute.fleet.small_fleet import small_text
from tests.precompute.measurements.test_response_table import COARSE, per_newton, rows
from tests.tactable.cli.in_process import run_here, summary_of


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
