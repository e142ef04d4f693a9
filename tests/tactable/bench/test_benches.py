"""The benchmarks of the sweep, of the step in one process, and of a program beside touches."""

import io
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from engine.effects.rule_file import read_effects
from engine.table import Table
from tactable.bench.control_bench import print_control_bench, run_control_bench
from tactable.bench.step import RULES, STAGES, print_step_bench, run_step_bench
from tactable.bench.sweep import print_sweep_bench, run_sweep_bench
from tactable.shipped import device_folder, find_device
from tests.engine.made_table import every_click, rows_of, write_table
from tests.tactable.rig.strokes import Stroke, make_recording

MESSAGES = 10
ROUNDS = 3
DEVICE = find_device("reference-a")
RECORDING = make_recording((Stroke(0.0, 0.4, 0.1, 0.9), Stroke(0.1, 0.3, 0.5, 0.5)))


@pytest.mark.machine
def test_each_round_times_a_touch_and_a_message_in_the_same_run(tmp_path: Path) -> None:
    path = write_table(tmp_path / "bar.nc", DEVICE, every_click(DEVICE))
    with Table.open(path, verify=False) as table:
        result = run_control_bench(table, MESSAGES)
    json.dumps(result, allow_nan=False)
    for row in result["rows"]:
        assert row["control_steps"] == row["answer"]["count"] == MESSAGES
        assert row["touch"]["count"] + row["message"]["count"] + row["without_a_command"] == 2 * MESSAGES
        assert row["ratio_p50"] == row["message"]["p50_us"] / row["touch"]["p50_us"]
        assert row["ratio_p99"] is None  # ten samples have no 99th percentile
        assert row["mispredicted"] == 0
    assert result["rows"][1]["answered_by_compiled_step"] == 0
    shown = io.StringIO()
    print_control_bench(Console(file=shown, width=160), result)
    assert "the Python loop" in shown.getvalue()


def test_the_sweep_is_timed_beside_the_time_to_write_its_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tactable.bench.sweep.ROUNDS", 1)
    result = run_sweep_bench(find_device("reference-a"))
    json.dumps(result, allow_nan=False)
    assert result["times_the_floor"] == result["sweep_s"] / result["memory_floor_s"] > 0
    page = io.StringIO()
    print_sweep_bench(Console(file=page, width=120), result)
    assert "floor" in page.getvalue()


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    rules = {**RULES, "slider": read_effects(device_folder().parent / "effects" / "slider.toml", DEVICE)}
    path = write_table(tmp_path_factory.mktemp("bench") / "bar.nc", DEVICE, every_click(DEVICE), rows=rows_of(DEVICE))
    recordings = {"strokes": RECORDING, "none": replace(RECORDING, reports=())}
    with Table.open(path, verify=False) as table:
        return run_step_bench(table, recordings, rules, ROUNDS)


def test_every_stage_of_every_command_is_timed_beside_figures_of_the_same_run(result: dict[str, Any]) -> None:
    strokes, _ = result["recordings"]
    held, looked_up, clicked, slid = strokes["rules"]
    for drives in (held, looked_up):
        assert drives["commands"]["SET"] > 0 == drives["commands"]["PLAY"]
    assert clicked["commands"]["PLAY"] >= 2 * ROUNDS
    assert slid["commands"]["PLAY"] >= 2 * ROUNDS
    for found in strokes["rules"]:
        stages = found["stages"]
        assert list(stages) == list(STAGES)
        assert {stage["count"] for stage in stages.values()} == {sum(found["commands"].values())}
        assert max(stage["p50_us"] for stage in stages.values()) < found["report_to_bytes"]["p50_us"]
        assert found["decode_every_report"]["count"] == ROUNDS * strokes["reports"] == ROUNDS * len(RECORDING.reports)
        whole_us = found["report_to_bytes"]["p50_us"]
        assert found["ratio_to_plainest"] == whole_us / strokes["rules"][0]["report_to_bytes"]["p50_us"]


@pytest.mark.skipif(not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="no C compiler")
def test_the_compiled_step_is_compared_over_the_reports_that_it_answers(result: dict[str, Any]) -> None:
    """Of drives for positions, which are solved, these are the silences; the rows of the sweep are looked up."""
    held, looked_up, clicked, _ = result["recordings"][0]["rules"]
    assert held["answered"] < looked_up["answered"] <= 1 and clicked["answered"] > 0
    for found in (looked_up, clicked):
        fast, same = found["compiled_step"], found["same_reports"]
        assert 0 < same["count"] <= ROUNDS * fast["count"] <= sum(found["commands"].values())
        assert found["ratio_to_compiled"] == same["p50_us"] / fast["p50_us"]


def test_a_recording_without_reports_has_no_figures(result: dict[str, Any]) -> None:
    _, none = result["recordings"]
    names = ("report_to_bytes", "ratio_to_plainest", "ratio_to_compiled", "compiled_step", "answered")
    for found in none["rules"]:
        assert [found[name] for name in names] == [None] * 5
    json.dumps(result, allow_nan=False)
    page = io.StringIO()
    print_step_bench(Console(file=page, width=200), result)
    assert "slider" in page.getvalue()
