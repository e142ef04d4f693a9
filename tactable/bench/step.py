"""Times the stages of the engine's step, from a report in hand to the bytes of its command, in one process.

Every report of a recording passes all stages once a round. The sets of rules take turns within a round, so that all of
them meet the same machine; each figure stands beside that of the plainest rules of the same run. The compiled step
looks up and never solves, so it is compared over the reports that it answers under the same rules.
"""

import platform
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table as Grid

from base.arrays import Array
from engine.device import Device
from engine.effects.rules import DEFAULT_EFFECTS, Drives, Effects
from engine.loop import realtime
from engine.loop.pipeline import open_pipeline
from engine.render.limits import link_configuration
from engine.render.prepared import render_table
from engine.render.renderer import PlayCommand
from engine.table import Table
from engine.touch import FingerTracker, Touch, TouchFrame
from engine.touch.sources.recording import Recording
from firmware_link.host.link import Link
from firmware_link.host.link_values import LinkConfiguration, LinkState
from tactable.bench.ends import LightDevice
from tactable.bench.in_process import InProcess, measure_in_process
from tactable.bench.inputs import HELD, replayed
from tactable.bench.latency.conditions import PTY_BIT_RATE_HZ, reading_ns
from tactable.bench.latency.stages import figures_of, us
from tactable.rig.emulate import configuration_of
from tactable.run.live_run import fast_library

ROUNDS = 15  # of all reports of a recording; their median is shown
STAGES = ("decode", "track", "play", "render", "frame")
"""Report to touch frame; to fingers; to placement and level by the rules; to the command; to its bytes."""
_HANDSHAKE_STEP_NS = 500_000  # of virtual time: finer than any pause of the handshake
_PAUSE_NS = 1_000_000_000
# What the link owes anyway, such as a renewal, leaves this long before a report and is not counted.
_EARLIER_NS = 2_000_000
Stamps = Array  # shape (report, stage + 1): ns from the start of the step, NaN for a stage that was not reached
IN_ZONES = replace(HELD, drives=Drives.ZONES)
RULES = {"a drive while touched": HELD, "a row while touched": IN_ZONES, "a click for every touch": DEFAULT_EFFECTS}
"""Rules to compare: the simplest, which bring drives for positions or for zones; then those that bring clicks."""


def run_step_bench(
    table: Table, recordings: Mapping[str, Recording], rules: Mapping[str, Effects] = RULES, rounds: int = ROUNDS
) -> dict[str, Any]:
    """Time every report of each recording `rounds` times under each set of rules, all by their names.

    Raises what opening a digitizer or rendering the table raises.
    """
    library, clock_ns = fast_library(), reading_ns()
    rules = {name: each for name, each in rules.items() if each.drives is Drives.POSITIONS or table.best_rows}
    rows = []
    for recording_name, recording in recordings.items():
        steps = {name: Step(table, recording, effects) for name, effects in rules.items()}
        stamps: dict[str, list[Stamps]] = {name: [] for name in steps}
        with realtime.real_time((realtime.Step.COLLECTOR,)):  # as in a run
            for _ in range(rounds):
                for name, step in steps.items():
                    stamps[name].append(step.run())
        found = [_figures(name, step, np.concatenate(stamps[name]), clock_ns) for name, step in steps.items()]
        for figures, name in zip(found, steps, strict=True):
            compiled = None
            if library is not None and recording.reports:
                stream = replayed(recording)
                compiled = measure_in_process(table, stream, len(recording.reports), library, rules[name])
            figures |= _compared(np.concatenate(stamps[name]), compiled, clock_ns)
        rows.append({"recording": recording_name, "reports": len(recording.reports), "rules": found})
        for figures in found:
            figures["ratio_to_plainest"] = _ratio(figures["report_to_bytes"], found[0]["report_to_bytes"])
    machine = {"python": platform.python_version(), "rounds": rounds, "clock_ns": clock_ns}
    return {"machine": machine, "device": table.device.name, "recordings": rows}


def _figures(rules: str, step: "Step", stamps: Stamps, clock_ns: float) -> dict[str, Any]:
    """Stages and whole over the reports that brought a command, and the decoding of every report."""
    durations = np.maximum(np.diff(stamps, axis=1) - clock_ns, 0)
    with_command = durations[np.isfinite(durations).all(axis=1)]
    return {
        "rules": rules,
        "commands": dict(step.commands),
        "stages": {name: figures_of(with_command[:, i]) for i, name in enumerate(STAGES)},
        "report_to_bytes": figures_of(with_command.sum(axis=1)),
        "decode_every_report": figures_of(durations[:, 0]),
    }


def _compared(stamps: Stamps, compiled: InProcess | None, clock_ns: float) -> dict[str, Any]:
    """Figures of the compiled step, and of this one over the same reports: those whose command both brought.

    None without the compiled step, and where it answers none. answered: its share of the commands of one round.
    """
    if compiled is None:
        return {"compiled_step": None, "same_reports": None, "answered": None, "ratio_to_compiled": None}
    both = compiled.has_command & compiled.is_fast
    whole_ns = (stamps[:, -1] - clock_ns * len(STAGES)).reshape(-1, len(both))[:, both].ravel()
    fast, same = figures_of(compiled.answer_ns[both]), figures_of(whole_ns[np.isfinite(whole_ns)])
    return {
        "compiled_step": fast,
        "same_reports": same,
        "answered": float(both.sum() / max(compiled.has_command.sum(), 1)),
        "ratio_to_compiled": _ratio(same, fast),
    }


def _ratio(one: Mapping[str, Any] | None, other: Mapping[str, Any] | None) -> float | None:
    """Of the medians: the mean on a shared machine would be that of its pauses. None where one is missing."""
    return one["p50_us"] / other["p50_us"] if one and other else None


class Step:
    """One set of rules on one recording, with a link to an emulated firmware without a line in between."""

    def __init__(self, table: Table, recording: Recording, effects: Effects) -> None:
        device = self._device = table.device
        capabilities = _ready_link(link_configuration(device, PTY_BIT_RATE_HZ), device)[0].capabilities
        assert capabilities is not None  # a link that is ready was greeted
        rendering = render_table(table, effects, capabilities, PTY_BIT_RATE_HZ)
        rendering.renderer.steady.prepare()
        self._renderer, self._click_ns, self._effects = rendering.renderer, rendering.click_length_ns, effects
        self._link, self._far_end, self._now_ns = _ready_link(rendering.configuration, device)
        self._recording = recording
        self.commands = {"SET": 0, "PLAY": 0}  # how many commands of each kind all rounds brought

    def run(self) -> Stamps:
        """One round, with fingers and effects at their start; time goes on from the round before."""
        recording, clock = self._recording, time.perf_counter_ns
        pipeline = open_pipeline(recording, self._device, self._effects, self._renderer, clock, self._click_ns)
        tracker = pipeline.tracker = _StampedTracker(self._device, pipeline.digitizer.surface)
        rows = []
        start_ns = self._now_ns + _PAUSE_NS
        for report in recording.reports:
            report_ns = round(1e9 * report.time_s)
            now_ns = self._now_ns = start_ns + report_ns
            self._exchange(now_ns - _EARLIER_NS)
            for _ in pipeline.commands_due(report_ns):  # what is due by now comes first, as in the loop
                pass
            marks = [clock()]
            rows.append(marks)
            command = pipeline.step(report.data, report_ns)
            if pipeline.frame is None:
                marks.append(clock())
                continue
            marks += [pipeline.frame_ns, tracker.tracked_ns]
            if command is None:
                continue
            marks += [pipeline.state_ns, clock()]
            command.hand_to(self._link)
            data = self._link.outgoing(now_ns)
            marks.append(clock())
            self.commands["PLAY" if isinstance(command, PlayCommand) else "SET"] += 1
            self._link.receive(self._far_end.receive(data, now_ns), now_ns)
        stamps = np.full((len(rows), len(STAGES) + 1), np.nan)
        for stamp, marks in zip(stamps, rows, strict=True):
            stamp[: len(marks)] = np.array(marks) - marks[0]
        return stamps

    def _exchange(self, now_ns: int) -> None:
        link, device = self._link, self._far_end
        link.receive(device.receive(link.outgoing(now_ns), now_ns) + device.run_until(now_ns), now_ns)


class _StampedTracker(FingerTracker):
    """A tracker that notes when the fingers of a frame are known, between the stamps of the pipeline."""

    tracked_ns = 0

    def track(self, frame: TouchFrame) -> list[Touch]:
        touches = super().track(frame)
        self.tracked_ns = time.perf_counter_ns()
        return touches


def _ready_link(configuration: LinkConfiguration, device: Device) -> tuple[Link, LightDevice, int]:
    """A link that an emulated firmware has armed, that firmware, and their time by then."""
    now_ns = _HANDSHAKE_STEP_NS
    link, far_end = Link(configuration), LightDevice(configuration_of(device), now_ns)
    link.connect(now_ns)
    while link.state is not LinkState.READY:
        now_ns += _HANDSHAKE_STEP_NS
        link.receive(far_end.receive(link.outgoing(now_ns), now_ns) + far_end.run_until(now_ns), now_ns)
    return link, far_end, now_ns


def print_step_bench(out: Console, result: dict[str, Any]) -> None:
    """Print medians in us: of the stages of a report that brings a command, and of the decoding of any report."""
    head = ("report to bytes", "p99", "ratio", "compiled step", "of commands", "its ratio", "decode, every report")
    grid = Grid("recording", "rules", *STAGES, *head)
    for row in result["recordings"]:
        for found in row["rules"]:
            figures = [found["stages"][name] or {} for name in STAGES]
            whole = found["report_to_bytes"] or {}
            plainest, compiled = (
                "-" if found[name] is None else f"{found[name]:.2f}"
                for name in ("ratio_to_plainest", "ratio_to_compiled")
            )
            grid.add_row(
                row["recording"],
                found["rules"],
                *(us(figure.get("p50_us")) for figure in figures),
                us(whole.get("p50_us")),
                us(whole.get("p99_us")),
                plainest,
                us((found["compiled_step"] or {}).get("p50_us")),
                "-" if found["answered"] is None else f"{100 * found['answered']:.0f} %",
                compiled,
                us((found["decode_every_report"] or {}).get("p50_us")),
            )
    out.print(grid)
