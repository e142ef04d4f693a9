"""The command build with measured responses: what it builds, what it says of it, how it refuses."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from engine.table import Table
from precompute.measurements.csv import write_csv
from precompute.measurements.types import Kind
from tactable.cli.main import app
from tests.precompute.fleet.small_fleet import small_text
from tests.precompute.measurements.test_responses import COARSE, rows


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The coarse device, and its responses as a file."""
    (tmp_path / "bar.toml").write_text(small_text(), encoding="utf-8")
    measured = rows(COARSE, np.arange(60.0, 301.0, 5.0), 22)
    assert measured.kind is Kind.RESPONSE
    (tmp_path / "bar.csv").write_text(write_csv(measured, COARSE, "SIMULATED"), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_it_says_what_is_measured_and_what_is_an_estimate(folder: Path) -> None:
    done = CliRunner().invoke(app, ["build", "bar.toml", "-o", "bar.nc", "--responses", "bar.csv", "--workers", "1"])
    assert done.exit_code == 0, done.output
    for part in ("0 clicks", "measured responses (SIMULATED) in bar.csv", "ESTIMATE", "there are no clicks"):
        assert part in done.stdout
    with Table.open(folder / "bar.nc") as table:
        assert table.attributes["responses_file"] == "bar.csv"
    words = ["build", "bar.toml", "-o", "bar.nc", "--workers", "1", "--json"]
    done = CliRunner().invoke(app, [*words, "--responses", "bar.csv"])
    summary = json.loads(done.stdout)
    assert summary["source"] == "measured responses (SIMULATED)"
    assert summary["estimates"] == len(COARSE.estimated_values)
    assert summary["model_disagreement"]["left"] < 1e-5
    done = CliRunner().invoke(app, [*words, "--clicks-up-to", "0"])
    assert json.loads(done.stdout)["source"] == "model"
