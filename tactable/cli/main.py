"""The command `tactable`: words to calls, results to a page for people or JSON for machines."""

import json
import math
import os
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from threadpoolctl import threadpool_limits

from engine.device import Device, DeviceError
from engine.effects import DEFAULT_EFFECTS, EffectError, read_effects
from engine.loop.ring import RingError
from engine.render.limits import LimitError
from engine.render.renderer import RendererError
from engine.table import Table, TableError
from engine.table.entry import DEFAULT_LEVEL_DB, played_at
from engine.touch import DescriptorError, DigitizerError, ZoneState, open_digitizer
from engine.touch.sources.recording import RecordingError, read_recording
from firmware_link.protocol.errors import TactableError
from precompute.fleet.units import FleetError
from precompute.measurements import CalibrationError
from tactable.bench import clicks as bench_clicks
from tactable.bench import step as bench_step
from tactable.bench.latency import command as bench_latency
from tactable.bench.latency.report import LatencyReportError
from tactable.cli import build as build_commands
from tactable.cli import calibrate as calibrate_commands
from tactable.cli import diff as diff_commands
from tactable.cli import emulate as link_commands
from tactable.cli import fleet as fleet_commands
from tactable.cli import plot as plot_commands
from tactable.cli import plot_bar as plot_bar_commands
from tactable.cli import plot_click as plot_click_commands
from tactable.cli import run as run
from tactable.cli import study as study_commands
from tactable.cli import touch as touch_commands
from tactable.figures.file import FigureError
from tactable.progress import shown_progress
from tactable.shipped import DEMO_RECORDING, cache_folder, find_device

EXIT_DISAGREES = 3

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Localized touch feedback on touch bars, rendered from tables.",
)
bench = typer.Typer(no_args_is_help=True, help="Measure speed on this machine, against floors measured beside it.")
app.add_typer(bench, name="bench")
build_commands.register(app)
touch_commands.register(app)
calibrate_commands.register(app)
link_commands.register(app)
diff_commands.register(app)
fleet_commands.register(app)
run.register(app)
bench_clicks.register(bench)
bench_step.register(bench)
bench_latency.register(bench)
plot_bar_commands.register(plot_commands.plot)
plot_click_commands.register(plot_commands.plot)
app.add_typer(plot_commands.plot, name="plot")
app.add_typer(study_commands.study, name="study")
_errors = Console(stderr=True)
_out = Console()

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON for machines.")]
DeviceName = Annotated[str, typer.Argument(metavar="DEVICE", help="A device file, or a shipped name.")]


def main() -> None:
    """Run the command; every error of ours is one line and exit status 1."""
    try:
        app()
    except (
        CalibrationError,
        DescriptorError,
        DeviceError,
        DigitizerError,
        EffectError,
        FigureError,
        FleetError,
        LimitError,
        LatencyReportError,
        TactableError,
        RecordingError,
        RendererError,
        RingError,
        TableError,
        OSError,
    ) as error:
        if isinstance(error, BrokenPipeError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise SystemExit(1) from None
        _errors.print(f"tactable: {error}", style="red", markup=False, highlight=False, soft_wrap=True)
        raise SystemExit(1) from None


@app.command()
def explain(
    table_path: Annotated[Path, typer.Argument(metavar="TABLE", help="A built table.")],
    felt: Annotated[str, typer.Option(help="Zones to be felt, such as I,III,V.")],
    quiet: Annotated[str, typer.Option(help="Zones with a finger that must not feel.")] = "",
    level: Annotated[
        str, typer.Option(help="Wanted level in dB above the detection threshold, or full.")
    ] = f"{DEFAULT_LEVEL_DB:g}",
    alternatives: Annotated[bool, typer.Option(help="Show what lost, and why.")] = True,
    click: Annotated[bool, typer.Option("--click", help="The click of the state instead of its steady drive.")] = False,
    as_json: AsJson = False,
) -> None:
    """Say what the table does for a state, what it promises, and what lost."""
    names = _zone_names(felt)
    if not names:
        raise TableError("--felt names no zone; give at least one, such as --felt I,III")
    level_db = _level(level)
    explain_it = _explain_click if click else _explain_entry
    with Table.open(table_path) as table, threadpool_limits(1, "blas"):
        explain_it(table, table.states_of(names, _zone_names(quiet)), level_db, alternatives, as_json)


def _explain_entry(
    table: Table, states: tuple[ZoneState, ...], level_db: float, alternatives: bool, as_json: bool
) -> None:
    from precompute.builder.measured_responses import plant_of
    from precompute.builder.on_demand import entries_on_demand
    from precompute.entries.alternatives import solve_alternatives
    from tactable.explain.entry import entry_json, print_entry

    tabulated = entries_on_demand(table, states, cache_folder() / "states")
    entry = played_at(tabulated, level_db, table.device.limits.amplitude)
    rivals = solve_alternatives(plant_of(table), states, entry) if alternatives else []
    if as_json:
        _print_json(entry_json(table, entry, rivals))
    else:
        print_entry(_out, table, entry, rivals)


def _explain_click(
    table: Table, states: tuple[ZoneState, ...], level_db: float, alternatives: bool, as_json: bool
) -> None:
    from tactable.explain.click import click_json, explain_click, print_click
    from tactable.explain.click_source import ClickSource

    explained = explain_click(ClickSource(table), states, level_db, rivals=alternatives)
    if as_json:
        _print_json(click_json(table, explained))
    else:
        print_click(_out, table, explained)


def _zone_names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _level(text: str) -> float:
    if text.strip() == "full":
        return math.inf
    try:
        level_db = float(text.removesuffix("dB"))
    except ValueError:
        level_db = math.nan
    if not 0 <= level_db < math.inf:
        raise TableError(f"--level {text!r}: expected dB above threshold, 0 or more, such as 20, or full")
    return level_db


@app.command()
def replay(
    recording_path: Annotated[Path, typer.Argument(metavar="RECORDING", help="A recording in hid-recorder form.")],
    frames: Annotated[bool, typer.Option("--frames", help="Print every completed touch frame.")] = False,
    as_json: AsJson = False,
) -> None:
    """Read a recording as the engine does: all of it, without waiting."""
    recording = read_recording(recording_path)
    digitizer = open_digitizer(recording.descriptor, recording.vendor_id, recording.product_id)
    completed = 0
    for report in recording.reports:
        frame = digitizer.decode_report(report.data, round(report.time_s * 1e9))
        if frame is None:
            continue
        completed += 1
        contacts = [{"id": c.contact_id, "x": c.x, "y": c.y, "tip": c.tip} for c in frame.contacts]
        if frames and as_json:
            print(json.dumps({"report": report.index, "t_s": report.time_s, "contacts": contacts}))  # noqa: T201
        elif frames:
            shown = "  ".join(f"{c['id']}: {c['x']},{c['y']}{'' if c['tip'] else ' hovers'}" for c in contacts)
            _out.print(f"{report.index:6d} {report.time_s:10.4f} s  {shown or 'nothing'}", markup=False)
    if not frames:
        _summarise_replay(recording.name, len(recording.reports), completed, digitizer.surface.kind.name, as_json)


def _summarise_replay(name: str, reports: int, completed: int, kind: str, as_json: bool) -> None:
    if as_json:
        _print_json({"name": name, "kind": kind, "reports": reports, "touch_frames": completed})
    else:
        _out.print(
            f"{name}: {kind.lower().replace('_', ' ')}, {reports} reports, {completed} touch frames", markup=False
        )


@app.command()
def demo(
    device_name: Annotated[str, typer.Option("--device", help="A device file, or a shipped name.")] = "reference-a",
    recording_path: Annotated[
        Path | None, typer.Option("--recording", help="Touches in hid-recorder form; default: the shipped ones.")
    ] = None,
    table_path: Annotated[
        Path | None, typer.Option("--table", help="Where the table is or goes; default: a cache.")
    ] = None,
    effects_path: Annotated[
        Path | None, typer.Option("--effects", help="Which fingers feel what; default: a click for every touch.")
    ] = None,
    figure: Annotated[
        Path | None, typer.Option("--figure", help="Where the picture goes; default: tactable-demo.png.")
    ] = None,
    headless: Annotated[
        bool, typer.Option("--headless", help="No page: recorded touches, and a report; so with --json, --figure, too.")
    ] = False,
    no_open: Annotated[bool, typer.Option("--no-open", help="Print the page's address and open no browser.")] = False,
    host: Annotated[
        str | None, typer.Option("--host", help="Bind the page to this address instead of 127.0.0.1.")
    ] = None,
    page_port: Annotated[int, typer.Option("--page-port", min=0, max=65_535, help="Of the page; 0: any free.")] = 0,
    as_json: AsJson = False,
) -> None:
    """Touches to felt zones without hardware: a page to touch; or a report, whether what was promised is what is done.

    Without a browser, and with --headless, --json, --figure, --recording or --table, it is the report.
    """
    device = find_device(device_name)
    is_report = headless or as_json or any(path is not None for path in (figure, recording_path, table_path))
    is_asked_for = no_open or host is not None or page_port != 0
    if is_report and is_asked_for:
        raise typer.BadParameter("--no-open, --host and --page-port are the page's; leave out what asks for the report")
    if not is_report:
        from tactable.page.opening import Address, has_browser, show_demo

        opens_browser = not no_open and host is None and has_browser()
        if opens_browser or is_asked_for:
            address = Address(host or "127.0.0.1", page_port, opens_browser)
            show_demo(device_name, device, effects_path, cache_folder(), address, _tell)
            return
        _tell("no browser here: the report instead of the page; --no-open prints an address to open elsewhere")
    _report_demo(device, recording_path, table_path, effects_path, figure or Path("tactable-demo.png"), as_json)


def _tell(line: str) -> None:
    _errors.print(line, markup=False, highlight=False, soft_wrap=True)


def _report_demo(
    device: Device,
    recording_path: Path | None,
    table_path: Path | None,
    effects_path: Path | None,
    figure: Path,
    as_json: bool,
) -> None:
    from tactable.figures.demo import draw_demo
    from tactable.rig.demo import demo_json, run_demo, table_for
    from tactable.rig.demo_page import print_demo

    recording = read_recording(recording_path or DEMO_RECORDING)
    effects = DEFAULT_EFFECTS if effects_path is None else read_effects(effects_path, device)
    path = table_path or cache_folder() / f"{device.name}-{device.fingerprint[:12]}.nc"
    with shown_progress(as_json) as progress:
        table = table_for(device, path, progress)
    with table:
        report = run_demo(table, recording, effects)
    draw_demo(report, figure)
    if as_json:
        _print_json({**demo_json(report), "figure": str(figure)})
    else:
        print_demo(_out, report, figure)
    if not report.agrees:
        raise typer.Exit(EXIT_DISAGREES)


@bench.command("sweep")
def bench_sweep(
    device_name: Annotated[str, typer.Option("--device", help="A device file, or a shipped name.")] = "reference-a",
    as_json: AsJson = False,
) -> None:
    """How fast tables are computed: against NumPy, against the point-by-point way, against writing to memory."""
    from tactable.bench.sweep import print_sweep_bench, run_sweep_bench

    result = run_sweep_bench(find_device(device_name))
    if as_json:
        _print_json(result)
    else:
        print_sweep_bench(_out, result)


@bench.command("states")
def bench_states(
    device_name: Annotated[str, typer.Option("--device", help="A device file, or a shipped name.")] = "reference-a",
    as_json: AsJson = False,
) -> None:
    """How long the entries of every state take, and how long a general-purpose solver would."""
    from tactable.bench.entries import print_states_bench, run_states_bench

    result = run_states_bench(find_device(device_name))
    if as_json:
        _print_json(result)
    else:
        print_states_bench(_out, result)


@bench.command("contrast")
def bench_contrast(
    table_path: Annotated[Path, typer.Argument(metavar="TABLE", help="A built table.")],
    level: Annotated[str, typer.Option(help="Wanted level in dB above the detection threshold, or full.")] = "20",
    as_json: AsJson = False,
) -> None:
    """Every state of one felt and one quiet finger: the paper's objective against ours, in frequency and in time."""
    from tactable.bench.entries import print_contrast_bench, run_contrast_bench

    with Table.open(table_path) as table:
        result = run_contrast_bench(table, _level(level))
    if as_json:
        _print_json(result)
    else:
        print_contrast_bench(_out, result)


def _print_json(value: object) -> None:
    print(json.dumps(value, indent=2))  # noqa: T201  # JSON goes out as it is, without a terminal's width


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
