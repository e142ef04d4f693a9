"""The benchmarks of clicks: every pair of zones three ways on the same plants."""

import io
from dataclasses import replace

import pytest
from rich.console import Console

from precompute.clicks import ClickSolver
from tactable.bench.clicks import print_clicks_bench, run_clicks_bench
from tests.precompute.clicks.click_cases import CHEAP, placed
from tests.precompute.devices import shipped, with_zones

DEVICE = with_zones(shipped("reference-a"), 3)
COARSE = replace(DEVICE, sweep=replace(DEVICE.sweep, step_hz=8.0))


@pytest.mark.machine
def test_every_ordered_pair_is_compared_as_the_solvers_say() -> None:
    told = list[float]()
    result = run_clicks_bench(COARSE, CHEAP, 1, told.append)
    pairs = {(row["felt"], row["quiet"]): row for row in result["pairs"]}
    assert set(pairs) == {(a, b) for a in ("I", "II", "III") for b in ("I", "II", "III") if a != b}
    assert told == pytest.approx([i / 6 for i in range(1, 7)])
    evaluation = ClickSolver(COARSE, CHEAP).solve(placed(COARSE, "F-q")).evaluation
    row = pairs["I", "III"]
    assert evaluation.quiet is not None
    found = (row["click"]["felt_db"]["low_db"], row["click"]["quiet_db"]["high_db"])
    assert found == pytest.approx((evaluation.felt.low_db, evaluation.quiet.high_db), abs=1e-3)  # single precision
    for way in ("gated", "paper"):
        assert all(row[way]["felt_db"]["low_db"] < row["click"]["felt_db"]["low_db"] + 0.5 for row in pairs.values())
        assert result["summary"][way]["least_felt_db"] == min(r[way]["felt_db"]["low_db"] for r in pairs.values())
    page = Console(file=io.StringIO(), width=200)
    print_clicks_bench(page, result)
    assert isinstance(page.file, io.StringIO)
    assert "steady drive gated" in page.file.getvalue() and "SIMULATED" in page.file.getvalue()
