"""What a click costs the loop: from a touch report to the bytes of PLAY, against those of SET, in the same run."""

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table as Grid

from engine.device import Device
from engine.effects import EffectPlayer, Effects, Rule, Trigger
from engine.effects.rules import burst, click
from engine.render.limits import link_configuration
from engine.render.renderer import Command, DriveCommand, PlayCommand
from engine.table.entry import DEFAULT_LEVEL_DB
from engine.touch import FingerTracker, open_digitizer
from firmware_link.emulator import DeviceConfiguration, EmulatedFirmware
from firmware_link.host.link import Link
from firmware_link.host.link_values import LinkConfiguration, LinkState
from firmware_link.protocol.bank import Bank
from firmware_link.protocol.messages import DRIVE_SIZE
from tactable.bench.decode import clock_cost_ns, summarise
from tactable.rig.virtual_digitizer import Stroke, make_recording
from tactable.shipped import find_device

TAPS = 200
ROUNDS = 15
_TAP_S, _PAUSE_S = 0.06, 0.2
_RATE_HZ = 4000
_SAMPLES = 121
_WAVEFORMS = 200
_BIT_RATE_HZ = 2_000_000
_STEP_US = 500
_EARLIER_NS = 5_000_000
_out = Console()

Times = NDArray[np.int64]


def register(bench: typer.Typer) -> None:
    """Add the command to the benchmarks."""

    @bench.command("commands")
    def bench_commands(
        as_json: Annotated[bool, typer.Option("--json", help="Print JSON for machines.")] = False,
    ) -> None:
        """What a click costs from report to bytes, against a steady drive."""
        result = run_commands_bench()
        if as_json:
            print(json.dumps(result, indent=2))  # noqa: T201  # JSON goes out as it is, without a terminal's width
        else:
            print_commands_bench(_out, result)


@dataclass(frozen=True)
class _Way:
    """How a touch is answered."""

    name: str
    effects: Effects
    command_of: Callable[[int], Command]


def run_commands_bench(taps: int = TAPS, rounds: int = ROUNDS) -> dict[str, Any]:
    """Time each report that brings a command, from its bytes to those of the frame; both ways in turn."""
    device = find_device("reference-a")
    states = 3 ** len(device.zones)
    drive = DriveCommand(b"\x01" * DRIVE_SIZE * len(device.actuators))
    ways = [
        _Way("SET", Effects((Rule(Trigger.TOUCH, burst(DEFAULT_LEVEL_DB, 30)),)), lambda _: drive),
        _Way(
            "PLAY",
            Effects((Rule(Trigger.TOUCH, click(DEFAULT_LEVEL_DB)),)),
            lambda state: PlayCommand(state % _WAVEFORMS, 0.5),
        ),
    ]
    strokes = [
        Stroke(i * _PAUSE_S, i * _PAUSE_S + _TAP_S, 0.1 + 0.2 * (i % 5), 0.1 + 0.2 * (i % 5)) for i in range(taps)
    ]
    reports = [(r.data, round(1e9 * r.time_s)) for r in make_recording(tuple(strokes)).reports]
    configuration = link_configuration(device, _BIT_RATE_HZ)
    links = [_armed_link(configuration) for _ in ways]
    times: dict[str, list[Times]] = {way.name: [] for way in ways}
    for turn in range(rounds):
        for way, (link, ready_ns) in zip(ways, links, strict=True):
            commands = {state: way.command_of(state) for state in range(states)}
            start_ns = ready_ns + round(1e9 * _PAUSE_S) * (taps + 1) * turn
            times[way.name].append(_time_commands(device, way.effects, commands, reports, link, start_ns))
    rows: list[dict[str, Any]] = []
    for name, parts in times.items():
        spent = np.concatenate(parts)
        rows.append({"command": name, "count": len(spent), **summarise(spent)})
    rows[1]["ratio"] = rows[1]["median_us"] / rows[0]["median_us"]
    return {"rounds": rounds, "clock_ns": clock_cost_ns(), "commands": rows}


def _time_commands(
    device: Device,
    effects: Effects,
    commands: dict[int, Command],
    reports: list[tuple[bytes, int]],
    link: Link,
    start_ns: int,
) -> Times:
    recording = make_recording((Stroke(0.0, 0.1, 0.5, 0.5),))
    digitizer = open_digitizer(recording.descriptor, recording.vendor_id, recording.product_id)
    tracker, player = FingerTracker(device, digitizer.surface), EffectPlayer(effects, len(device.zones))
    spent, before = list[int](), player.level_db
    for data, report_ns in reports:
        now_ns = start_ns + report_ns
        while player.next_change_ns is not None and player.next_change_ns <= report_ns:
            player.advance(player.next_change_ns)
        before = player.level_db
        link.outgoing(now_ns - _EARLIER_NS)  # what is due anyway
        begin_ns = time.perf_counter_ns()
        frame = digitizer.decode_report(data, report_ns)
        if frame is None:
            continue
        player.take(tracker.track(frame), report_ns)
        if player.level_db == before or player.level_db is None:
            continue
        commands[player.state].hand_to(link)
        written = link.outgoing(now_ns)
        end_ns = time.perf_counter_ns()
        assert written
        spent.append(end_ns - begin_ns)
    return np.array(spent)


def _armed_link(configuration: LinkConfiguration) -> tuple[Link, int]:
    """A link that an emulated firmware has armed, without a line between them; and its time then."""
    waveform = np.zeros((_SAMPLES, configuration.number_of_actuators), dtype=np.int16)
    bank = Bank(_RATE_HZ, (waveform,) * _WAVEFORMS)
    link = Link(LinkConfiguration(**configuration.__dict__ | {"bank": bank}))
    firmware, now_us = EmulatedFirmware(DeviceConfiguration(1)), 0
    link.connect(0)
    while link.state is not LinkState.READY:
        now_us += _STEP_US
        answer = firmware.receive(link.outgoing(1000 * now_us), now_us)
        link.receive(answer, 1000 * now_us)
    return link, 1000 * (now_us + 20 * _STEP_US)


def print_commands_bench(out: Console, result: dict[str, Any]) -> None:
    """The same as a table."""
    grid = Grid("report to bytes of", "median µs", "p99 µs", "mean µs", "ratio")
    for row in result["commands"]:
        figures = [f"{row[key]:.2f}" for key in ("median_us", "p99_us", "mean_us")]
        grid.add_row(row["command"], *figures, f"{row['ratio']:.2f}" if "ratio" in row else "1")
    out.print(grid)
