"""The report says in numbers and in words what the fit says; JSON takes it, and every row of a table is whole."""

import json
from functools import cache
from typing import Any

import numpy as np
import pytest

from precompute.calibration.calibration_report import calibration_report, open_text, report_markdown
from tests.precompute.calibration.calibrations import noisy_calibration, published_calibration
from tests.precompute.measured import PAIRS_HZ


@cache
def report() -> dict[str, Any]:
    return calibration_report(noisy_calibration())


def test_the_report_is_json_with_the_numbers_of_the_fit() -> None:
    again = json.loads(json.dumps(report(), allow_nan=False))
    assert again["simulated"] is True
    assert again["readings"] == 66
    for told, estimate in zip(again["parameters"], noisy_calibration().estimates, strict=True):
        assert (told["name"], told["value"]) == (estimate.parameter.name, estimate.value)
        assert told["interval"] == [estimate.low, estimate.high]
    assert len(again["wrong_readings"]) == noisy_calibration().is_wrong.sum() == 3
    assert len(again["correlations"]) == 15
    sizes = [abs(pair["correlation"]) for pair in again["correlations"]]
    assert sizes == sorted(sizes, reverse=True) and sizes[0] <= 1 + 1e-9
    drives = [f"{left} Hz and {right} Hz" for left, right in PAIRS_HZ[:3]]
    assert [row["drive"] for row in again["residual_by_drive"]] == drives
    assert [row["readings"] for row in again["residual_by_position"]] == [3] * 22
    worst = max(abs(row["greatest"]) for row in again["residual_by_drive"])
    assert worst == pytest.approx(np.abs(noisy_calibration().log_residual).max())
    assert worst == pytest.approx(np.log(3), abs=0.1)


def test_the_page_has_whole_tables_and_says_simulated() -> None:
    page = report_markdown(report())
    assert page.startswith("# Calibration of reference-a SIMULATED\n")
    tables = [block.splitlines() for block in page.split("\n\n") if block.startswith("|")]
    assert len(tables) == 3
    for table in tables:
        assert len({line.count("|") for line in table}) == 1
    assert "taken for wrong" not in page and "times the fitted" in page


def test_what_is_open_is_told_with_what_would_close_it() -> None:
    text = open_text(calibration_report(published_calibration()))
    assert "bar.mass_damping alone: it hardly changes what was measured" in text
    assert "bar.mass_damping is at most" in text
    assert "plan-measurements" in text
