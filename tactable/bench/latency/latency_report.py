"""Measures a plan and makes the report of it: a versioned document, its page and summary, and all samples."""

import json
import math
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from base.errors import TactableError
from base.files import replace_file, work_folder, write_text
from base.plain import to_plain
from engine.table import Table
from engine.touch.sources.recording import read_recording
from firmware_link.host.link_values import BOARD_EMULATED
from tactable.bench.in_process import REPORTS_HZ, measure_in_process, together
from tactable.bench.inputs import Stream, replayed, tapping
from tactable.bench.latency.compare import compare, compare_runs, median, percentile, ratio
from tactable.bench.latency.conditions import Condition, Plan, Transport, background_load, environment_json
from tactable.bench.latency.latency_page import page_markdown, page_pictures
from tactable.bench.latency.load_generator import Stall
from tactable.bench.latency.segments import Bench, Measured, build_program
from tactable.bench.latency.stages import STAGES, Point, Stamps, Values, blame, stages_json
from tactable.run.live_run import fast_library

FORMAT, REVISION = "tactable latency", 2
_IN_PROCESS_REPORTS = 4_000  # p99 has forty samples beyond it; p99.9 is a dash
_LEAST_FOR_P99_9 = 10_000  # ten samples lie beyond it (docs/latency.md)
_US = 1e3
_PROVENANCE = ("code_fingerprint", "format_revision", "created")  # attributes of a table that the report repeats
_METHOD = (
    "Open loop: each report has a time at which it is due, whatever became of those before it, and all times count "
    "from there. One clock for all stages but the device's. A change whose command a newer one replaced unsent counts "
    "until that one was written. A percentile is one of the samples; a dash means too few."
)
_SUMMED = (
    "reports_sent",
    "reports_lost",
    "commands",
    "answered_by_fast_path",
    "mispredicted",
    "replaced_unsent",
    "stale_sent",
    "sessions_lost",
    "released_by_watchdog",
)


class LatencyReportError(TactableError, ValueError):
    """A table that cannot be measured, or a report that cannot be used as a baseline: which, and why."""


@dataclass(frozen=True)
class Run:
    """All segments of a measurement by condition, in the order of their rounds."""

    plan: Plan
    measured: Mapping[Condition, Sequence[Measured]]

    def rounds(self) -> dict[str, list[Stamps]]:
        """Stamps by the name of their condition."""
        return {condition.name: [part.stamps for part in parts] for condition, parts in self.measured.items()}

    def ways_us(self) -> dict[str, Values]:
        """From due to written of each sample (sample,), us, by the name of the condition."""
        return {name: np.concatenate(parts)[:, Point.WRITTEN] / _US for name, parts in self.rounds().items()}


def measure(
    table: Table,
    plan: Plan,
    streams: Sequence[tuple[int, Stream]],
    recordings: Sequence[Path],
    transport: Transport,
    seconds: float,
    rounds: int,
    stall: Stall | None,
    on_progress: Callable[[str], None],
) -> tuple[dict[str, Any], Run]:
    """The document of the report, and all samples. `streams` are (rate in Hz, touches).

    Raises LatencyReportError for a table without clicks, LinkError or ChildError where engine, port or device fails.
    """
    if not table.clicks:
        raise LatencyReportError(f"{table.path}: has no clicks, which the touches bring: build it with them")
    stream = streams[0][1]
    with work_folder("latency") as folder:
        # Of a recording only the engine knows which reports bring a command, so the C program cannot answer alike.
        is_generated = stream.reports_per_command is not None
        program = build_program("echo_engine", folder) if plan.has_echo and is_generated else None
        plan = replace(plan, has_echo=program is not None)
        with Bench(table, dict(streams), folder, transport, program) as bench:
            measured = _measure_rounds(bench, plan, seconds, rounds, stall, on_progress)
    run = Run(plan, measured)
    boards = {part.facts.get("board") for parts in measured.values() for part in parts}
    touches = "the touches" if stream.simulated else "the digitizer, which only repeats a recording"
    document = run_json(run) | {
        "simulated": [touches, *(["the firmware"] if BOARD_EMULATED in boards else [])],
        "method": _METHOD + f" Touches: {stream.name}; over {transport.name}.",
        "floor_note": _floor_note(plan.has_echo, transport),
        "command": shlex.join(["tactable", *sys.argv[1:]]),
        "environment": environment_json() | {"exchange_between_processors_ns": bench.exchanges_ns},
        "apparatus": to_plain(bench.generator_outcomes),
        "configuration": {
            "rates_hz": plan.rates_hz,
            "loads": plan.loads,
            "steps": plan.steps,
            "over": transport.name,
            "bit_rate_hz": transport.bit_rate_hz,
            "seconds": seconds,
            "rounds": rounds,
            "stall": stall,
        },
        "table": {
            "path": table.path,
            "device": table.device.name,
            "device_fingerprint": table.fingerprint,
            **{name: str(table.attributes[name]) for name in _PROVENANCE if name in table.attributes},
        },
        "in_process": _in_process(table, recordings),
    }
    return to_plain(document), run


def _measure_rounds(
    bench: Bench, plan: Plan, seconds: float, rounds: int, stall: Stall | None, on_progress: Callable[[str], None]
) -> dict[Condition, list[Measured]]:
    """Every segment of every round by its condition, each under the background load of its part of the round."""
    measured: dict[Condition, list[Measured]] = {}
    done, count = 0, rounds * sum(len(plan.conditions(load)) for load in plan.loads)
    for number, load, conditions in plan.rounds(rounds):
        bench.measure_exchange()
        with background_load(load):
            for condition in conditions:
                done += 1
                on_progress(f"round {number + 1}: {done} of {count}: {condition.name}")
                measured.setdefault(condition, []).append(bench.measure(condition, seconds, stall))
    bench.measure_exchange()
    return measured


def _in_process(table: Table, recordings: Sequence[Path]) -> list[dict[str, Any]]:
    """One tapping finger, two, ten, and each recording, then all of them."""
    fast = fast_library()
    taps = [tapping(count, REPORTS_HZ, table.device) for count in (1, 2, 10)]
    made = [measure_in_process(table, stream, _IN_PROCESS_REPORTS, fast) for stream in taps]
    read = [recording for recording in map(read_recording, recordings) if recording.reports]
    recorded = [measure_in_process(table, replayed(recording), len(recording.reports), fast) for recording in read]
    return [part.figures_json() for part in (*made, *recorded, *([together(recorded)] if len(recorded) > 1 else []))]


def _floor_note(has_echo: bool, transport: Transport) -> str:
    if not has_echo:
        return "No ratio: there is no C echo engine beside a recording, without a C compiler, or where it was left out."
    note = "The C echo engine wakes up for the same reports and writes as many bytes; it decodes nothing."
    if transport.is_sockets:
        return note
    return note + " It writes into a socket pair: the driver of the port is in no floor."


def run_json(run: Run) -> dict[str, Any]:
    """Conditions, the ratios to their floors, and the layers that cost most."""
    return {
        "format": FORMAT,
        "revision": REVISION,
        "whole": "due to written",
        "stages": {stage.name: {"layer": stage.layer, "meaning": stage.meaning} for stage in STAGES.values()},
        "conditions": [_condition_json(condition, parts) for condition, parts in run.measured.items()],
        "ratios": _ratios(run),
    }


def _condition_json(condition: Condition, parts: Sequence[Measured]) -> dict[str, Any]:
    stamps = np.concatenate([part.stamps for part in parts])
    facts: dict[str, Any] = {key: sum(part.facts[key] for part in parts) for key in _SUMMED if key in parts[0].facts}
    if "order_kept" in parts[0].facts:
        kept = [part.facts["order_kept"] for part in parts]
        facts["order_kept"] = False if False in kept else None if None in kept else True
        facts["clock_bounds_us"] = max(part.facts["clock_bounds_us"] for part in parts)
    return {
        "name": condition.name,
        "engine": condition.engine,
        "rate_hz": condition.rate_hz,
        "load": str(condition.load),
        "steps": [{**to_plain(outcome), "in_force": outcome.in_force} for outcome in parts[0].outcomes],
        "steps_asked": condition.steps_text,
        "rounds": len(parts),
        **facts,
        **stages_json(stamps),
        "blame": blame(stamps),
    }


def _ratios(run: Run) -> list[dict[str, Any]]:
    """Each condition against its floor in the same run: the ways from due and from sent to written."""
    rows = []
    for condition, parts in run.measured.items():
        floor = run.plan.floor_of(condition)
        if floor is None or floor not in run.measured:
            continue
        for since in (Point.DUE, Point.SENT):
            ours, theirs = (
                [part.stamps[:, Point.WRITTEN] - part.stamps[:, since] for part in some]
                for some in (parts, run.measured[floor])
            )
            way = f"{since.name.lower()} to written"
            row: dict[str, Any] = {"condition": condition.name, "against": floor.engine, "way": way}
            has_tail = min(sum(map(len, ours)), sum(map(len, theirs))) >= _LEAST_FOR_P99_9
            for name, statistic, is_known in (
                ("median", median, True),
                ("p99_9", partial(percentile, share=99.9), has_tail),
            ):
                found = compare(ours, theirs, statistic, ratio)
                row[name] = to_plain(found) if is_known and math.isfinite(found.value) else None
            rows.append(row)
    return rows


def read_baseline(path: Path, plan: Plan) -> dict[str, list[Stamps]]:
    """Stamps of a baseline, a report.json, by condition. Raises LatencyReportError where they are of no use."""
    try:
        before = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise LatencyReportError(f"{path}: is no report ({error}); give a report.json") from error
    if (before.get("format"), before.get("revision")) != (FORMAT, REVISION):
        raise LatencyReportError(f"{path}: is no {FORMAT} of revision {REVISION}: measure it again")
    rounds = read_samples(path.with_name("samples.npz"))
    planned = [condition for load in plan.loads for condition in plan.conditions(load)]
    floors = {plan.floor_of(condition) for condition in planned}
    if not any(condition.name in rounds for condition in planned if condition not in floors):
        raise LatencyReportError(f"{path}: has none of these conditions: measure with its own command")
    return rounds


def compare_with(run: Run, baseline: Mapping[str, Sequence[Stamps]]) -> dict[str, Any]:
    """Every condition that the baseline has, too."""
    floors = ((condition, run.plan.floor_of(condition)) for condition in run.measured)
    floor_of = {condition.name: floor.name for condition, floor in floors if floor is not None}
    return compare_runs(run.rounds(), baseline, floor_of)


def write_report(document: dict[str, Any], run: Run, folder: Path) -> None:
    """Write report.md with its pictures, report.json and samples.npz."""
    folder.mkdir(parents=True, exist_ok=True)
    pictures = page_pictures(document, run.ways_us())
    for name, picture in pictures.items():
        with replace_file(folder / name) as partial:
            picture.savefig(partial, format="png", dpi=110)
    write_text(folder / "report.json", json.dumps(to_plain(document), indent=2))
    write_text(folder / "report.md", page_markdown(document, list(pictures)))
    write_samples(run, folder / "samples.npz")


def write_samples(run: Run, path: Path) -> None:
    """Write every stamp: `NAME/ROUND` is (sample, point) in ns after `NAME/ROUND/due` (sample,)."""
    arrays: dict[str, Any] = {"points": np.array([point.name for point in Point])}
    for condition, parts in run.measured.items():
        for number, part in enumerate(parts):
            arrays[f"{condition.name}/{number}"] = part.stamps
            arrays[f"{condition.name}/{number}/due"] = part.due_ns
    with replace_file(path) as partial, partial.open("wb") as file:
        np.savez_compressed(file, **arrays)


def read_samples(path: Path) -> dict[str, list[Stamps]]:
    """Stamps of each condition by its name, one array a round. Raises LatencyReportError for another file."""
    rounds: dict[str, list[Stamps]] = {}
    try:
        with np.load(path) as arrays:
            if [str(name) for name in arrays["points"]] != [point.name for point in Point]:
                raise LatencyReportError(f"{path}: its points are others than ours: measure the baseline again")
            for key in arrays.files:
                name, _, number = key.rpartition("/")
                if number.isdecimal():
                    rounds.setdefault(name, []).append(arrays[key])
    except LatencyReportError:
        raise
    except (OSError, KeyError, ValueError) as error:
        raise LatencyReportError(f"{path}: holds no samples of ours ({error}); it lies beside its report") from error
    return rounds
