"""A plan to a report: every segment measured, floors beside it, document, page and samples written."""

import json
import math
import shlex
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from engine.table import Table
from engine.touch.sources.recording import read_recording
from firmware_link.emulator import BOARD_EMULATED
from tactable.bench.in_process import measure_in_process, together
from tactable.bench.inputs import Stream, replayed, tapping
from tactable.bench.latency.compare import compare_runs
from tactable.bench.latency.environment import environment_json
from tactable.bench.latency.floor import build_echo_engine
from tactable.bench.latency.load import load_running
from tactable.bench.latency.page import page_html, page_markdown
from tactable.bench.latency.plan import Plan
from tactable.bench.latency.report import LatencyReportError, Run, read_samples, run_json, write_samples
from tactable.bench.latency.run import Bench, Condition, Measured, Way
from tactable.bench.latency.source import Stall
from tactable.bench.latency.stages import Point, Stamps, Values
from tactable.run.live import fast_library

_IN_PROCESS_REPORTS = 4_000
_US = 1e3
Told = Callable[[str], None]
_METHOD = (
    "Open loop: each report has a time at which it is due, whatever became of those before it, and all times count "
    "from there. One clock for all stages but the device's. A change whose command a newer one replaced unsent counts "
    "until that one was written. A percentile is one of the samples; a dash means too few."
)


def measure(
    table: Table,
    plan: Plan,
    streams: Sequence[tuple[int, Stream]],
    recordings: Sequence[Path],
    way: Way,
    seconds: float,
    rounds: int,
    stall: Stall | None,
    told: Told,
) -> tuple[dict[str, Any], Run]:
    """The document of the report and all samples. Raises LinkError where engine, port or device fails."""
    measured: dict[Condition, list[Measured]] = {}
    with tempfile.TemporaryDirectory(prefix="tactable-latency-") as name:
        folder = Path(name)
        # Of a recording only the engine knows which reports bring a command.
        is_generated = streams[0][1].reports_per_command is not None
        program = build_echo_engine(folder) if plan.has_echo and is_generated else None
        has_echo = program is not None
        plan = replace(plan, has_echo=has_echo)
        segments, done = rounds * plan.segments_a_round, 0
        with Bench(table, dict(streams), folder, way, program) as bench:
            for number, load, conditions in plan.rounds(rounds):
                with load_running(load):
                    for condition in conditions:
                        done += 1
                        told(f"round {number + 1}: {done} of {segments}: {condition.name}")
                        measured.setdefault(condition, []).append(bench.measure(condition, seconds, stall))
            apparatus = [asdict(outcome) for outcome in bench.apparatus_outcomes]
    run = Run(plan, measured)
    streamed = streams[0][1]
    boards = {part.facts.get("board") for parts in measured.values() for part in parts} - {None}
    document = run_json(run) | {
        "simulated": _simulated(streamed, boards),
        "method": _METHOD + f" Touches: {streamed.name}; over {way.name}.",
        "floor_note": _floor_note(has_echo, way),
        "command": shlex.join(["tactable", *sys.argv[1:]]),
        "environment": environment_json(),
        "apparatus": apparatus,
        "configuration": {
            "rates_hz": list(plan.rates_hz),
            "loads": [str(load) for load in plan.loads],
            "steps": [str(step) for step in plan.steps],
            "over": way.name,
            "bit_rate_hz": way.bit_rate_hz,
            "seconds": seconds,
            "rounds": rounds,
            "stall": None if stall is None else asdict(stall),
        },
        "table": _table_json(table),
        "in_process": _in_process(table, recordings),
    }
    return document, run


def _in_process(table: Table, recordings: Sequence[Path]) -> list[dict[str, Any]]:
    """One tapping finger, ten, and each recording, then all of them."""
    fast = fast_library()
    taps = [tapping(count, 1_000, table.device) for count in (1, 10)]
    made = [measure_in_process(table, stream, _IN_PROCESS_REPORTS, fast) for stream in taps]
    read = [recording for recording in map(read_recording, recordings) if recording.reports]
    recorded = [measure_in_process(table, replayed(recording), len(recording.reports), fast) for recording in read]
    return [part.figures_json() for part in (*made, *recorded, *([together(recorded)] if len(recorded) > 1 else []))]


def _table_json(table: Table) -> dict[str, Any]:
    names = ("code_fingerprint", "format_revision", "created")
    attributes = {name: str(table.attributes[name]) for name in names if name in table.attributes}
    return {"path": str(table.path), "device": table.device.name, "device_fingerprint": table.fingerprint} | attributes


def _simulated(stream: Stream, boards: set[Any]) -> list[str]:
    touches = "the touches" if stream.simulated else "the digitizer, which only repeats a recording"
    return [touches, *(["the firmware"] if BOARD_EMULATED in boards else [])]


def _floor_note(has_echo: bool, way: Way) -> str:
    if not has_echo:
        return "No ratio: there is no C echo engine beside a recording, without a C compiler, or where it was left out."
    note = "The C echo engine wakes up for the same reports and writes as many bytes; it decodes nothing."
    return note if way.is_sockets else note + " It writes into a socket pair: the driver of the port is in no floor."


def ways_us(parts: Sequence[Stamps]) -> Values:
    """From due to written of each sample, us."""
    whole: Values = np.concatenate(parts)[:, Point.WRITTEN] / _US
    return whole


def compare_with(run: Run, baseline: Path) -> dict[str, Any]:
    """Each condition that a baseline (its report.json) has too. Raises LatencyReportError where it is of no use."""
    try:
        before = json.loads(baseline.read_text(encoding="utf-8"))
    except ValueError as error:
        raise LatencyReportError(f"{baseline}: is no report ({error}); give a report.json") from error
    ours = run_json(run)
    if (before.get("format"), before.get("revision")) != (ours["format"], ours["revision"]):
        raise LatencyReportError(f"{baseline}: is no {ours['format']} of revision {ours['revision']}: measure it again")
    floors = ((condition, run.plan.floor_of(condition)) for condition in run.measured)
    floor_of = {condition.name: floor.name for condition, floor in floors if floor is not None}
    compared = compare_runs(run.rounds(), read_samples(baseline.with_name("samples.npz")), floor_of)
    if not compared:
        raise LatencyReportError(f"{baseline}: has none of these conditions: measure with its own command")
    return compared


def write_report(document: dict[str, Any], run: Run, ways_us: dict[str, Values], folder: Path) -> None:
    """report.html, report.md, report.json and samples.npz."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "report.json").write_text(json.dumps(_finite(document), indent=2), encoding="utf-8")
    (folder / "report.html").write_text(page_html(document, ways_us), encoding="utf-8")
    (folder / "report.md").write_text(page_markdown(document), encoding="utf-8")
    write_samples(run, folder / "samples.npz")


def _finite(value: Any) -> Any:
    """The same for JSON, which has neither infinity nor NaN: None instead."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
