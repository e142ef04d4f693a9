"""The benchmarks of clicks: every pair three ways on the same plants, and growth in processes of their own."""

import io
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from precompute.clicks.solver import ClickSolver
from tactable.bench.click_growth import draw_growth, print_growth, run_growth
from tactable.bench.clicks import print_clicks_bench, run_clicks_bench
from tactable.figures.file import write_columns, write_picture
from tests.precompute.clicks.click_cases import CHEAP, states
from tests.precompute.devices import shipped, with_zones

DEVICE = with_zones(shipped("reference-a"), 3)
COARSE = replace(DEVICE, sweep=replace(DEVICE.sweep, step_hz=8.0))


def test_every_ordered_pair_is_compared_as_the_solvers_say() -> None:
    told = list[float]()
    result = run_clicks_bench(COARSE, CHEAP, 2, told.append)
    pairs = {(row["felt"], row["quiet"]): row for row in result["pairs"]}
    assert set(pairs) == {(a, b) for a in ("I", "II", "III") for b in ("I", "II", "III") if a != b}
    assert told == pytest.approx([i / 6 for i in range(1, 7)])
    verdict = ClickSolver(COARSE, CHEAP).solve(states("F-q")).verdict
    row = pairs["I", "III"]
    assert verdict.quiet is not None
    assert (row["click"]["felt_db"]["low_db"], row["click"]["quiet_db"]["high_db"]) == (
        verdict.felt.low_db,
        verdict.quiet.high_db,
    )
    for way in ("gated", "paper"):
        assert all(row[way]["felt_db"]["low_db"] < row["click"]["felt_db"]["low_db"] + 0.5 for row in pairs.values())
        assert result["summary"][way]["least_felt_db"] == min(r[way]["felt_db"]["low_db"] for r in pairs.values())
    page = Console(file=io.StringIO(), width=200)
    print_clicks_bench(page, result)
    assert isinstance(page.file, io.StringIO)
    assert "steady drive gated" in page.file.getvalue() and "SIMULATED" in page.file.getvalue()


def test_growth_is_measured_one_by_one_and_drawn(tmp_path: Path) -> None:
    result = run_growth(
        COARSE, lambda _: None, zones=(2, 3), scenarios=(), lengths_ms=(10,), options=replace(CHEAP, scenarios=4)
    )
    assert [(row["varied"], row["value"], row["states"]) for row in result["rows"]] == [
        ("zones", 2, 5),
        ("zones", 3, 19),
        ("length_ms", 10, 19),
    ]
    assert all(row["all_states_s"] > 0 and row["memory_mib"] > 10 for row in result["rows"])
    assert result["exponents"]["length_ms"] is None and result["exponents"]["zones"] > 0
    picture = draw_growth(result)
    write_picture(picture, tmp_path / "growth.png")
    write_columns(picture, tmp_path / "growth.csv")
    assert (tmp_path / "growth.png").stat().st_size > 1000
    assert (tmp_path / "growth.csv").read_text().count("\n") == 4
    page = Console(file=io.StringIO(), width=200)
    print_growth(page, result)
    assert isinstance(page.file, io.StringIO) and "(from 15)" not in page.file.getvalue().splitlines()[4]
