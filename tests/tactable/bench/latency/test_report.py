"""The report: samples come back as they were, the page needs nothing but itself, and what is simulated says so."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.loop.realtime import ALL_STEPS
from tactable.bench.latency.load import Load
from tactable.bench.latency.measure import write_report
from tactable.bench.latency.page import page_html, page_markdown
from tactable.bench.latency.plan import Plan
from tactable.bench.latency.report import LatencyReportError, Run, read_samples, run_json, write_samples
from tactable.bench.latency.run import ECHO, TACTABLE, Condition, Measured, first_with_sequence
from tactable.bench.latency.stages import Point
from tests.tactable.bench.latency.test_stages import stamps_of

PLAN = Plan((1000,), (Load.IDLE,), ALL_STEPS, has_echo=True, ablates=False)
OURS, FLOOR = (Condition(engine, 1000, Load.IDLE, ALL_STEPS) for engine in (TACTABLE, ECHO))
FACTS = {
    "reports_sent": 400,
    "reports_lost": 0,
    "commands": 400,
    "replaced_unsent": 0,
    "stale_sent": 0,
    "sessions_lost": 0,
    "released_by_watchdog": 0,
    "order_kept": True,
    "clock_bounds_us": 20.0,
}


def made_run() -> Run:
    due_ns = np.arange(400, dtype=np.int64)
    ours = [Measured(stamps_of(400, READ=1e6), due_ns, FACTS) for _ in range(2)]
    floor = [Measured(stamps_of(400) / 2, due_ns, {"reports_sent": 400, "commands": 400})]
    return Run(PLAN, {OURS: ours, FLOOR: floor})


def document_of(run: Run) -> dict[str, Any]:
    return run_json(run) | {
        "simulated": ["the touches", "the firmware"],
        "method": "Open loop.",
        "floor_note": "It decodes nothing.",
        "command": "tactable bench latency <&>",
        "environment": {"clock": {"name": "CLOCK_MONOTONIC"}},
    }


def test_samples_come_back_as_they_were(tmp_path: Path) -> None:
    run = made_run()
    write_samples(run, tmp_path / "samples.npz")
    again = read_samples(tmp_path / "samples.npz")
    assert again.keys() == run.rounds().keys()
    for name, parts in run.rounds().items():
        for ours, theirs in zip(parts, again[name], strict=True):
            np.testing.assert_array_equal(ours, theirs)


def test_a_file_without_samples_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "samples.npz").write_bytes(b"no archive")
    with pytest.raises(LatencyReportError, match=r"samples\.npz: holds no samples"):
        read_samples(tmp_path / "samples.npz")
    np.savez(tmp_path / "others.npz", points=np.array(["DUE"]))
    with pytest.raises(LatencyReportError, match="its points are others"):
        read_samples(tmp_path / "others.npz")


def test_the_ratio_to_the_floor_is_that_of_the_medians() -> None:
    document = run_json(made_run())
    assert [row["way"] for row in document["ratios"]] == ["due to written", "sent to written"]
    assert [row["median"]["value"] for row in document["ratios"]] == [pytest.approx(2.0)] * 2
    assert document["ratios"][0]["p99_9"] is None
    assert (document["format"], document["revision"]) == ("tactable latency", 1)


def test_the_page_needs_nothing_but_itself_and_shows_every_condition(tmp_path: Path) -> None:
    run = made_run()
    ways = {name: np.concatenate(parts)[:, Point.WRITTEN] / 1e3 for name, parts in run.rounds().items()}
    page = page_html(document_of(run), ways)
    assert not re.search(r"(src|href)\s*=|@import|<script|https?://", page)
    assert page.count("<svg") == page.count("</svg>") == 2
    assert page.count("<polyline") == 4
    assert "SIMULATED: the touches, the firmware" in page
    assert "&lt;&amp;&gt;" in page
    write_report(document_of(run), run, ways, tmp_path / "new")
    assert {path.name for path in (tmp_path / "new").iterdir()} == {
        "report.html",
        "report.md",
        "report.json",
        "samples.npz",
    }
    assert json.loads((tmp_path / "new" / "report.json").read_text(encoding="utf-8"))["conditions"][0]["rounds"] == 2


def test_the_summary_names_the_layer_and_what_came_late() -> None:
    text = page_markdown(document_of(made_run()))
    assert "the slowest hundredth lost its time in host (wake-up, 100 %)" in text
    assert f"| {OURS.name} | 40 | 0 | 0 | 0 | 0 |" in text
    assert "    tactable bench latency <&>" in text


def test_an_arrival_belongs_to_the_latest_command_of_its_sequence() -> None:
    times, sequences = np.array([10, 20, 30, 400]), np.array([1, 2, 1, 2])
    since, wanted = np.array([5, 5, 25, 25, 5]), np.array([1, 2, 1, 2, 3])
    found = first_with_sequence(times, sequences, since, wanted, longest_ns=100)
    np.testing.assert_array_equal(found, [10, 20, 30, np.nan, np.nan])
