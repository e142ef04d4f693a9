"""Command `run`: touches of a digitizer, answered from a table, become commands on a serial port until Ctrl-C."""

import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from base.child import Child
from base.files import identity_of, work_folder
from engine.device import Device
from engine.effects.rules import Effects
from engine.loop.beside import Updates
from engine.loop.loop import Clock, StopRequest, SystemClock
from engine.loop.observer import Stage
from engine.loop.realtime import ALL_STEPS, Step, parse_steps
from engine.loop.ring import RingWriter
from engine.table import Table
from engine.touch.digitizer import FOREIGN_NOTICED
from engine.touch.sources import Source
from engine.touch.sources.recording import Playback, read_recording
from firmware_link import BIT_RATE_HZ
from firmware_link.host.link_values import BOARD_EMULATED, Capabilities
from firmware_link.host.serial_port import ReopeningPort, stable_name_of
from firmware_link.protocol.link_errors import LinkError
from tactable.audio.port import AudioPort, CardReopening, OpenPort, open_port
from tactable.cli import options
from tactable.cli.console import ERRORS, OUT, note, remark, show
from tactable.cli.touch import machine_of
from tactable.control.client import default_socket
from tactable.control.slot import ControlOf, ControlProcess
from tactable.digitizers.listing import SIMULATED
from tactable.digitizers.record import open_live, opened, recording_named, stop_at_signal
from tactable.doctor.touch_check import Machine
from tactable.kernel_cache import compile_steady_solver
from tactable.run.click_process import ClickProcess
from tactable.run.live_run import Live, LiveOptions, fast_library, ring_for
from tactable.run.table_watch import TableWatch, Watched
from tactable.run.track_status import read_status, track_text
from tactable.shipped import DEMO_RECORDING, find_device, find_table, named_effects
from tactable.track.track_process import TrackedSensor, TrackProcess

_Values = Callable[[], dict[str, Any]]
_NS_PER_S = 1_000_000_000

TouchName = Annotated[
    str, Option(metavar="PANEL|RECORDING", help="A digitizer as `list` shows it, a recording, or `simulated`.")
]
Refuses = Annotated[
    bool,
    Option("--refuse-not-achieved", help="Play silence where the bar cannot reach a level; default: its strongest."),
]
RequiredDevice = Annotated[str | None, Option("--device", help="Refuse the table unless it belongs to this device.")]
Reconnect = Annotated[bool, Option("--reconnect", help="Reconnect to a device that stopped itself or was unplugged.")]
RealTimeSteps = Annotated[
    str,
    Option(
        "--realtime",
        metavar="STEPS",
        help=f"all, none, or some of {', '.join(ALL_STEPS)}; all,-priority omits one.",
    ),
]
RingPath = Annotated[
    Path | None, Option("--ring", help="Shared memory from which other processes follow the run (engine/loop/ring.py).")
]
Watch = Annotated[bool, Option(help="Change over to a new table that replaces this one, once it is verified.")]
Solve = Annotated[bool, Option("--solve/--no-solve", help="Solve clicks that the table lacks, in another process.")]
Track = Annotated[
    str | None,
    Option(
        metavar="SENSOR",
        help="Follow drift and fingers by a sensor that stays, as board:35mm or PIPE@35mm,mass=2g (docs/tracking.md).",
    ),
]
FastPathWanted = Annotated[bool, Option("--fast-path/--no-fast-path", help="Answer reports in one compiled step.")]


@dataclass(frozen=True)
class Deadline:
    """Stop request that is set by another one, or at a time."""

    stop: StopRequest
    clock: Clock
    end_ns: float

    def is_set(self) -> bool:
        """Whether the run shall end."""
        return self.stop.is_set() or self.clock.now_ns() >= self.end_ns


def run(
    context: typer.Context,
    table_path: Annotated[Path, Argument(metavar="TABLE", help="A built table, or the device file beside it.")],
    touch: TouchName,
    port_name: options.PortName,
    rules_path: options.RulesPath = None,
    drives: options.DrivesOf = None,
    refuses: Refuses = False,
    seconds: Annotated[float, Option("--for", min=0.0, help="End after this time of playing.")] = math.inf,
    device_name: RequiredDevice = None,
    bit_rate_hz: options.BitRate = BIT_RATE_HZ,
    reconnect: Reconnect = False,
    steps: RealTimeSteps = "collector",
    ring_path: RingPath = None,
    watch: Watch = True,
    solve: Solve = True,
    page: Annotated[bool, Option("--page", help="Show the run to browsers, by another process.")] = False,
    page_at: Annotated[
        str | None, Option(metavar="HOST:PORT", help="Where to bind the page, as 0.0.0.0:8080 or :8080; default: here.")
    ] = None,
    control: Annotated[bool, Option("--control", help="Let other programs decide who feels what.")] = False,
    control_socket: options.ControlSocket = None,
    control_port: options.ControlPort = None,
    control_osc: options.ControlOsc = None,
    fast: FastPathWanted = True,
    track: Track = None,
    as_json: options.AsJson = False,
) -> None:
    """Play a table: turn touches into commands for the firmware.

    Ctrl-C ends the run; the firmware falls silent, and a summary is printed.
    """
    options.need_switch(context, "--page", page, "page_at")
    options.need_switch(context, "--control", control, "control_socket", "control_port", "control_osc")
    if track is not None and not watch:
        raise options.OptionError("--no-watch: --track makes tables, which the run must adopt: leave one of both out")
    page_host, page_port = _read_address(page_at or "")
    clock, named = SystemClock(), find_table(table_path)
    identity = identity_of(named) if named.is_file() else (0, 0, 0)
    device = None if device_name is None else find_device(device_name)
    with Table.open(named, device=device) as table, ExitStack() as stack:
        effects = _effects(rules_path, table.device, drives, with_others=control)
        realtime = real_time_steps(steps)
        with _opened(machine_of(context), touch) as source:
            # What is wrong is told before kernels are compiled; what is touched meanwhile is not of the run.
            open_live(machine_of(context), source)
        port = open_port(port_name, bit_rate_hz)
        reopening = stack.enter_context(_reopening(port, port_name, bit_rate_hz, reconnect))
        compile_steady_solver(remark)
        step = fast_library(note) if fast else None
        live_options = LiveOptions(effects, refuses, reconnect, port.bit_rate_hz, realtime, fast=step)
        source = stack.enter_context(_opened(machine_of(context), touch))
        tracked = None if track is None else TrackedSensor.parse(track, table.device)
        ring = stack.enter_context(ring_for(ring_path, is_needed=page or control or tracked is not None))
        table_path, tracking = named, None
        if tracked is not None and ring is not None:
            folder = stack.enter_context(work_folder("track"))
            tracking = stack.enter_context(TrackProcess(table, folder, ring.path, tracked))
            table_path, identity = tracking.played, tracking.identity
        stop = stack.enter_context(stop_at_signal())
        zones = tuple(zone.name for zone in table.device.zones)

        def watched(capabilities: Capabilities) -> Updates:
            asked = Watched(table_path, identity, zones, effects, capabilities, refuses, port.bit_rate_hz)
            return stack.enter_context(TableWatch(asked))

        solves = solve and effects.have_clicks and bool(table.clicks)
        solving = stack.enter_context(ClickProcess(table_path)) if solves else None
        found_again, watching, slot = reopening if reconnect else None, watched if watch else None, None
        if ring is not None and control:
            socket = control_socket or default_socket()
            served = ControlOf(socket, ring.path, table_path, control_port, control_osc, watch)
            slot = stack.enter_context(ControlProcess(served))
        beside = ring, found_again, watching, solving
        live = Live(table, source, port, clock, live_options, *beside, control=slot, measuring=tracking)
        if tracking is not None:
            tracking.begin_tracking(live.capabilities, live.fit.scales)
        if slot is not None:
            slot.begin_steps(live.capabilities)
        lines = list[str]()
        if ring is not None and page:
            shown = stack.enter_context(_page(live, ring, table_path, page_host, page_port))
            lines += shown.read()["lines"]
        for text in (*lines, *([] if slot is None else slot.lines)):
            note(text)
        _announce(source, port, live, refuses)

        def where() -> dict[str, Any]:
            track = None if tracking is None else read_status(table_path)
            return {"table": str(named), "device": table.device.name, "port": port.path, "track": track}

        _play(live, source, clock, stop, seconds, where, as_json)


def _read_address(text: str) -> tuple[str, int]:
    """Host and port of --page-at, by default this machine and any port. Raises OptionError."""
    host, _, port = text.rpartition(":") if ":" in text else (text, "", "")
    if port and not (port.isdecimal() and int(port) < 65_536):
        raise options.OptionError(f"--page-at {text}: expected HOST:PORT, as 0.0.0.0:8080, [::1]:8080 or :8080")
    return host.strip("[]") or "127.0.0.1", int(port or 0)


def _play(
    live: Live, source: Source, clock: Clock, stop: StopRequest, seconds: float, where: _Values, as_json: bool
) -> None:
    """Run until `stop` or for `seconds`, and print the summary in any case; `where` gives its first values."""
    start_ns, digitizer = clock.now_ns(), live.digitizer
    digitizer.on_foreign = note
    try:
        live.run(Deadline(stop, clock, start_ns + seconds * _NS_PER_S))
    finally:
        if digitizer.foreign_notice and digitizer.counters.foreign_reports < FOREIGN_NOTICED:
            note(digitizer.foreign_notice)  # too few came for it to be given before
        summary = where() | run_json(live, source, clock.now_ns() - start_ns)
        show(summary, as_json, lambda _, summary: _print_summary(summary))


def _effects(path: Path | None, device: Device, drives: str | None, *, with_others: bool) -> Effects:
    """The rules of a file; with the other named effects, too, where programs may name them during the run."""
    effects = options.read_rules(path, device, drives, note)
    return replace(effects, others=tuple(named_effects().values())) if with_others else effects


@contextmanager
def _reopening(port: OpenPort, name: str, bit_rate_hz: int, reconnect: bool) -> Iterator[ReopeningPort[OpenPort]]:
    """A port that can be opened again: by a name that stays where it is to be found again after an unplug."""
    with ExitStack() as stack:
        opens: Callable[[], OpenPort]
        if isinstance(port, AudioPort):
            opens = stack.enter_context(closing(CardReopening(port.another)))
        else:
            opens = partial(open_port, stable_name_of(name) if reconnect else name, bit_rate_hz)
        yield stack.enter_context(closing(ReopeningPort(_told(opens), port)))


def _page(live: Live, ring: RingWriter, table_path: Path, host: str, port: int) -> Child:
    """The process that serves the page of the run: it reads only the ring, and the loop never waits for it."""
    board = {key: getattr(live.capabilities, key) for key in ("frequency_resolution_hz", "full_scales_m")}
    shown = {"ring": str(ring.path), "table": str(table_path), **board, "host": host, "port": port}
    return Child("tactable.page.processes.live_process", shown, name=f"no page at {host}, port {port}")


def real_time_steps(text: str) -> tuple[Step, ...]:
    """Read the real-time steps of an option; an unknown word is a usage error."""
    try:
        return parse_steps(text)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error


@contextmanager
def _opened(machine: Machine, name: str) -> Iterator[Source]:
    """A source: a recording where there is a plain file of that name, else a digitizer; `simulated` never ends."""
    recorded = recording_named(name)
    if name == SIMULATED or recorded is not None:
        path, report_id = recorded or (DEMO_RECORDING, None)
        yield Playback(read_recording(path), report_id=report_id, repeats=name == SIMULATED)
        return
    with opened(machine, name) as (source, _):
        yield source


def _told(opened_again: Callable[[], OpenPort]) -> Callable[[], OpenPort]:
    """Wrap `opened_again` with notes: one when the port cannot be opened, and one when it is open again."""
    is_told = False

    def open_and_tell() -> OpenPort:
        nonlocal is_told
        try:
            port = opened_again()
        except LinkError as error:
            if not is_told:
                note(f"the port is lost, and looked for until it is back or Ctrl-C: {error}")
            is_told = True
            raise
        is_told = False
        note(f"{port.path} is open again")
        return port

    return open_and_tell


def _announce(source: Source, port: OpenPort, live: Live, refuses: bool) -> None:
    simulated = ", SIMULATED firmware" if live.capabilities.board == BOARD_EMULATED else ""
    ends = "the end of the recording or " if isinstance(source, Playback) and not source.repeats else ""
    ERRORS.print(f"{source.name} to {port.path}{simulated}; {ends}Ctrl-C ends", soft_wrap=True)
    for text in (*port.notes, *live.fit.notes):
        note(text)
    if not refuses:
        for level_db, clicks in live.renderer.click_shortfalls.items():
            if clicks:
                unfelt = "without being felt by quiet fingers: they are played as strong as they get"
                note(f"{clicks} of {live.clicks} clicks do not reach {level_db:g} dB {unfelt}")
    if live.no_fast_path:
        note(live.no_fast_path)
    if live.wants_clicks and not live.clicks:
        note(
            "no clicks: the table has none, the device plays none or too slowly, or the line is too slow for one in "
            "half a lease (`tactable doctor` says how slow); steady drives take their place"
        )


def run_json(live: Live, source: Source, duration_ns: int) -> dict[str, Any]:
    """Counters and times of a run as plain values."""
    counters, fast = live.loop.counters, live.fast_counters
    latency = live.timing.latency.summarise(Stage.AVAILABLE, Stage.WRITTEN)
    scans = live.timing.scan_times.summarise()
    return {
        "touches": source.name,
        "simulated_firmware": live.capabilities.board == BOARD_EMULATED,
        "duration_s": duration_ns / _NS_PER_S,
        "reports": counters.reports,
        "touch_frames": counters.frames,
        "state_changes": counters.state_changes,
        "commands_sent": counters.commands,
        "commands_by_fast_path": fast.answered,
        "commands_mispredicted": fast.mispredicted,
        "clicks": live.clicks,
        "full_scale_factors": list(live.fit.scales),
        "set_frames_on_the_wire": live.frames_sent,
        "not_achieved": live.renderer.not_achieved,
        "clicks_solved": counters.learned,
        "joined_fingers": counters.joined,
        "fingers_left_out": counters.left_out,
        "control_steps": counters.controlled,
        "changes_of_table": counters.swaps,
        "losses_of_the_port": counters.losses,
        "reconnects": counters.reconnects,
        "digitizer": asdict(live.digitizer.counters),
        "link": asdict(live.link.counters),
        "realtime": [{**asdict(outcome), "in_force": outcome.in_force} for outcome in live.outcomes],
        "report_to_command": None if latency is None else asdict(latency),
        "scan_time": None if scans is None else asdict(scans),
    }


def _print_summary(summary: dict[str, Any]) -> None:
    names = ("reports", "touch_frames", "state_changes", "commands_sent", "set_frames_on_the_wire")
    told = [f"{summary[name]} {name.replace('_', ' ')}" for name in names]
    rare = (
        "commands_mispredicted",
        "not_achieved",
        "clicks_solved",
        "joined_fingers",
        "fingers_left_out",
        "control_steps",
        "changes_of_table",
        "losses_of_the_port",
        "reconnects",
    )
    told += [f"{summary[name]} {name.replace('_', ' ')}" for name in rare if summary[name]]
    OUT.print(f"{summary['duration_s']:.1f} s: {', '.join(told)}", highlight=False, soft_wrap=True)
    if not summary["reports"]:
        note(f"no report came from {summary['touches']}: touch it, or see with `tactable record` what it sends")
    if text := track_text(summary["track"]):
        OUT.print(text, highlight=False, soft_wrap=True)
    for step in summary["realtime"]:
        if not step["in_force"]:
            OUT.print(f"{step['step']}: {step['finding']}; {step['remedy']}", soft_wrap=True)
    if latency := summary["report_to_command"]:
        figures = f"median {latency['p50_ns'] / 1e6:.2f} ms, greatest {latency['max_ns'] / 1e6:.2f} ms"
        OUT.print(f"report to command: {figures} of {latency['count']}", highlight=False)
    if scans := summary["scan_time"]:
        period_ms, jitter_ms = scans["period_ns"] / 1e6, scans["jitter_p99_ns"] / 1e6
        text = f"digitizer: a frame each {period_ms:.1f} ms by its own clock; host and line add up to {jitter_ms:.1f}"
        OUT.print(f"{text} ms (99 %)", highlight=False)
