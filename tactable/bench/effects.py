"""What effects cost the loop: the step from report to drive with them, and with every touch felt, of the same run."""

import json
import platform
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table as Grid

from engine.device import Device
from engine.effects import DEFAULT_EFFECTS, EffectPlayer, Effects
from engine.effects.rule_file import parse_effects
from engine.touch import FingerTracker, open_digitizer
from engine.touch.sources.recording import Recording, read_recording
from tactable.bench.decode import clock_cost_ns, summarise, time_calls
from tactable.shipped import DEMO_RECORDING, find_device

ROUNDS = 15
_DRIVE = bytes(12)
_EVERY_TRIGGER = """
[[effect]]
name = "burst"
envelope = [["50 ms", "20 dB"]]
[[effect]]
name = "purr"
envelope = [["30 ms", "20 dB"], ["held", "10 dB"]]
[[rule]]
on = "touch"
zones = ["I"]
effect = "purr"
[[rule]]
on = "touch"
region = ["20 %", "100 %"]
effect = "burst"
[[rule]]
on = "drag"
every = "2 mm"
effect = "burst"
[[rule]]
on = "hold"
after = "200 ms"
effect = "purr"
[[rule]]
on = "lift"
effect = "burst"
"""
Step = Callable[[bytes, int], bytes | None]
_out = Console()


def register(bench: typer.Typer) -> None:
    """Add the command to the benchmarks."""

    @bench.command("effects")
    def bench_effects(
        recording_path: Annotated[
            Path | None, typer.Argument(metavar="RECORDING", help="In hid-recorder form; default: the shipped one.")
        ] = None,
        as_json: Annotated[bool, typer.Option("--json", help="Print JSON for machines.")] = False,
    ) -> None:
        """What effects add to the step from a report to the drive it asks for."""
        result = run_effects_bench(read_recording(recording_path or DEMO_RECORDING))
        if as_json:
            print(json.dumps(result, indent=2))  # noqa: T201  # JSON goes out as it is, without a terminal's width
        else:
            print_effects_bench(_out, result)


def run_effects_bench(recording: Recording) -> dict[str, Any]:
    """Time the step of every report, `ROUNDS` times in turn, so that all meet the same machine.

    Raises what opening the digitizer raises.
    """
    device = find_device("reference-a")
    every_trigger = parse_effects(_EVERY_TRIGGER, "the benchmark's rules", device)
    makers: dict[str, Callable[[], Step]] = {
        "every touch felt": lambda: _plain_step(recording, device),
        "default effects": lambda: _effects_step(recording, device, DEFAULT_EFFECTS),
        "rules on every trigger": lambda: _effects_step(recording, device, every_trigger),
    }
    reports = [(report.data, round(report.time_s * 1e9)) for report in recording.reports]
    times: dict[str, list[NDArray[np.int64]]] = {name: [] for name in makers}
    for _ in range(ROUNDS):
        for name, make in makers.items():
            times[name].append(time_calls(make(), reports))
    rows: list[dict[str, Any]] = [{"step": name, **summarise(np.concatenate(parts))} for name, parts in times.items()]
    for row in rows[1:] if reports else ():
        row["ratio"] = row["median_us"] / rows[0]["median_us"]  # a mean on a shared machine is that of its pauses
    machine = {"python": platform.python_version(), "rounds": ROUNDS, "clock_ns": clock_cost_ns()}
    return {"machine": machine, "reports": len(reports), "steps": rows}


def _plain_step(recording: Recording, device: Device) -> Step:
    """The least that a touch needs: decode, zones, and the drive of these zones."""
    digitizer = open_digitizer(recording.descriptor, recording.vendor_id, recording.product_id)
    tracker, drives = FingerTracker(device, digitizer.surface), dict[frozenset[int | None], bytes]()

    def step(report: bytes, time_ns: int) -> bytes | None:
        frame = digitizer.decode_report(report, time_ns)
        if frame is None:
            return None
        return drives.get(frozenset([touch.zone for touch in tracker.track(frame)]), _DRIVE)

    return step


def _effects_step(recording: Recording, device: Device, effects: Effects) -> Step:
    """The same with effects, as the loop takes it: what is due before the report, then the report."""
    digitizer = open_digitizer(recording.descriptor, recording.vendor_id, recording.product_id)
    tracker, player = FingerTracker(device, digitizer.surface), EffectPlayer(effects, len(device.zones))
    drives: dict[float, dict[int, bytes]] = {level_db: {} for level_db in effects.levels_db}

    def step(report: bytes, time_ns: int) -> bytes | None:
        while player.next_change_ns is not None and player.next_change_ns <= time_ns:
            player.advance(player.next_change_ns)
        frame = digitizer.decode_report(report, time_ns)
        if frame is None:
            return None
        player.take(tracker.track(frame), time_ns)
        level_db = player.level_db
        return None if level_db is None else drives[level_db].get(player.state, _DRIVE)

    return step


def print_effects_bench(out: Console, result: dict[str, Any]) -> None:
    """The same as a table."""
    grid = Grid("report to drive", "median µs", "p99 µs", "mean µs", "ratio")
    for row in result["steps"]:
        ratio = f"{row['ratio']:.2f}" if "ratio" in row else "1"
        figures = [f"{row[key]:.2f}" if key in row else "-" for key in ("median_us", "p99_us", "mean_us")]
        grid.add_row(row["step"], *figures, ratio)
    out.print(grid)
