"""The plan, in which each engine has its floor and no condition is always the first, and the report of a run of it."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.loop.realtime import ALL_STEPS, Step
from tactable.bench.latency.conditions import ECHO, TACTABLE, ZONES, BackgroundLoad, Condition, Plan
from tactable.bench.latency.latency_page import page_markdown
from tactable.bench.latency.latency_report import (
    LatencyReportError,
    Run,
    read_samples,
    run_json,
    write_report,
    write_samples,
)
from tactable.bench.latency.segments import Measured
from tactable.bench.latency.stamps import first_with_sequence
from tests.tactable.bench.latency.test_stages import stamps_of

PLAN = Plan((125, 1000, 4000), tuple(BackgroundLoad), ALL_STEPS, has_echo=True, ablates=True, has_zones=True)


def test_steps_are_left_out_and_zones_played_once_at_the_middle_rate_under_stress() -> None:
    every = [condition for load in PLAN.loads for condition in PLAN.conditions(load)]
    left_out = [each for each in every if each.steps != ALL_STEPS and each.engine == TACTABLE]
    assert {(each.rate_hz, each.load) for each in left_out} == {(1000, BackgroundLoad.STRESS)}
    assert [each.steps_text for each in left_out] == ["none", *(f"all but {step}" for step in Step)]
    for plan, count in ((PLAN, 1), (replace(PLAN, has_zones=False), 0), (replace(PLAN, ablates=False), 0)):
        assert sum(each.engine == ZONES for load in plan.loads for each in plan.conditions(load)) == count


def test_each_engine_is_next_to_its_floor_and_rounds_begin_with_another_condition_and_measure_all() -> None:
    for load in (BackgroundLoad.IDLE, BackgroundLoad.STRESS):
        for rate_hz in PLAN.rates_hz:
            floor = PLAN.floor_of(Condition(TACTABLE, rate_hz, load, ALL_STEPS))
            assert floor == Condition(ECHO, rate_hz, load, ALL_STEPS)
            assert floor in PLAN.conditions(load)
            assert PLAN.floor_of(floor) is None
    assert PLAN.floor_of(Condition(TACTABLE, 1000, BackgroundLoad.THREAD, ALL_STEPS)) is None
    rounds = [conditions for _, load, conditions in PLAN.rounds(4) if load is BackgroundLoad.IDLE]
    assert len({conditions[0] for conditions in rounds}) == 4
    assert all(set(conditions) == set(PLAN.conditions(BackgroundLoad.IDLE)) for conditions in rounds)


RUN_PLAN = Plan((1000,), (BackgroundLoad.IDLE,), ALL_STEPS, has_echo=True, ablates=False, has_zones=True)
OURS, FLOOR = (Condition(engine, 1000, BackgroundLoad.IDLE, ALL_STEPS) for engine in (TACTABLE, ECHO))
NONE = dict.fromkeys(("reports_lost", "replaced_unsent", "stale_sent", "sessions_lost", "released_by_watchdog"), 0)
FACTS = {"reports_sent": 400, "commands": 400, "order_kept": True, "clock_bounds_us": 20.0, **NONE}


def made_run() -> Run:
    due_ns = np.arange(400, dtype=np.int64)
    ours = [Measured(stamps_of(400, READ=1e6), due_ns, FACTS) for _ in range(2)]
    floor = [Measured(stamps_of(400) / 2, due_ns, {"reports_sent": 400, "commands": 400})]
    return Run(RUN_PLAN, {OURS: ours, FLOOR: floor})


def document_of(run: Run) -> dict[str, Any]:
    return run_json(run) | {
        "simulated": ["the touches", "the firmware"],
        "method": "Open loop.",
        "floor_note": "It decodes nothing.",
        "command": "tactable bench latency <&>",
        "environment": {"clock": {"name": "CLOCK_MONOTONIC"}},
    }


def test_samples_come_back_as_they_were_and_a_file_without_any_is_refused_by_name(tmp_path: Path) -> None:
    run = made_run()
    write_samples(run, tmp_path / "samples.npz")
    again = read_samples(tmp_path / "samples.npz")
    assert again.keys() == run.rounds().keys()
    for name, parts in run.rounds().items():
        np.testing.assert_array_equal(parts, again[name])
    (tmp_path / "samples.npz").write_bytes(b"no archive")
    with pytest.raises(LatencyReportError, match=r"samples\.npz: holds no samples"):
        read_samples(tmp_path / "samples.npz")
    np.savez(tmp_path / "others.npz", points=np.array(["DUE"]))
    with pytest.raises(LatencyReportError, match="its points are others"):
        read_samples(tmp_path / "others.npz")


def test_the_ratio_to_the_floor_is_that_of_the_medians_and_the_summary_names_the_layer_and_what_came_late() -> None:
    document = document_of(made_run())
    text = page_markdown(document, [])
    assert "the slowest hundredth lost its time in host (wake-up, 100 %)" in text
    assert f"| {OURS.name} | 40 | 0 | 0 | 0 | 0 |" in text
    assert "    tactable bench latency <&>" in text
    assert [row["way"] for row in document["ratios"]] == ["due to written", "sent to written"]
    assert [row["median"]["value"] for row in document["ratios"]] == [pytest.approx(2.0)] * 2
    assert document["ratios"][0]["p99_9"] is None
    assert (document["format"], document["revision"]) == ("tactable latency", 2)


def test_the_page_shows_every_condition_and_its_picture(tmp_path: Path) -> None:
    run = made_run()
    write_report(document_of(run), run, tmp_path / "new")
    names = sorted(path.name for path in (tmp_path / "new").iterdir())
    assert names == ["idle-1.png", "report.json", "report.md", "samples.npz"]
    page = (tmp_path / "new" / "report.md").read_text(encoding="utf-8")
    assert "SIMULATED: the touches, the firmware" in page and "](idle-1.png)" in page
    assert (tmp_path / "new" / "idle-1.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads((tmp_path / "new" / "report.json").read_text(encoding="utf-8"))["conditions"][0]["rounds"] == 2


def test_an_arrival_belongs_to_the_latest_command_of_its_sequence() -> None:
    times, sequences = np.array([10, 20, 30, 400]), np.array([1, 2, 1, 2])
    since, wanted = np.array([5, 5, 25, 25, 5]), np.array([1, 2, 1, 2, 3])
    found = first_with_sequence(times, sequences, since, wanted, longest_ns=100)
    np.testing.assert_array_equal(found, [10, 20, 30, np.nan, np.nan])
