"""The command `tactable`: words to calls, results to a page for people or JSON for machines."""

import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table as Grid

from engine.descriptor import DescriptorError
from engine.device import DeviceError
from engine.digitizer import DigitizerError, open_digitizer
from engine.entry import Entry
from engine.limits import LimitError
from engine.renderer import RendererError
from engine.sources.recording import RecordingError, read_recording
from engine.table import Table, TableError, open_table
from firmware_link.errors import LinkError
from tactable import touch_commands
from tactable.shipped import DEMO_RECORDING, find_device

EXIT_DISAGREES = 3

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Localized touch feedback on touch bars, rendered from tables.",
)
bench = typer.Typer(no_args_is_help=True, help="Measure speed on this machine, against floors measured beside it.")
app.add_typer(bench, name="bench")
touch_commands.register(app)
_errors = Console(stderr=True)
_out = Console()

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON for machines.")]
DeviceName = Annotated[str, typer.Argument(metavar="DEVICE", help="A device file, or a shipped name.")]


def main() -> None:
    """Run the command; every error of ours is one line and exit status 1."""
    try:
        app()
    except (
        DescriptorError,
        DeviceError,
        DigitizerError,
        LimitError,
        LinkError,
        RecordingError,
        RendererError,
        TableError,
        OSError,
    ) as error:
        if isinstance(error, BrokenPipeError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise SystemExit(1) from None
        _errors.print(f"tactable: {error}", style="red", markup=False, highlight=False, soft_wrap=True)
        raise SystemExit(1) from None


@app.command()
def build(
    device_name: DeviceName,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="The table; default NAME.nc here.")] = None,
    memory_mib: Annotated[int, typer.Option(min=1, help="Memory for the buffers of the sweep, in MiB.")] = 64,
    as_json: AsJson = False,
) -> None:
    """Build the table of a device."""
    from precompute.build import build_table

    device = find_device(device_name)
    path = output or Path(f"{device.name}.nc")
    with _progress(as_json) as progress:
        build_table(device, path, created=_now(), memory_budget_bytes=memory_mib << 20, progress=progress)
    with open_table(path, verify=False) as table:
        summary = {
            "table": str(path),
            "device": device.name,
            "fingerprint": device.fingerprint,
            "entries": len(table.entries),
            "bytes": path.stat().st_size,
        }
    if as_json:
        _print_json(summary)
    else:
        _out.print(f"{path}: {summary['entries']} entries, {path.stat().st_size / 1e6:.0f} MB, for {device.name}")
        _out.print(f"fingerprint {device.fingerprint[:16]}; {len(device.inferred)} values of the device are estimates")


@app.command()
def explain(
    table_path: Annotated[Path, typer.Argument(metavar="TABLE", help="A built table.")],
    felt: Annotated[str, typer.Option(help="Zones to be felt, such as I,III,V.")],
    as_json: AsJson = False,
) -> None:
    """Say what the table does for a state, and what it promises."""
    names = [name.strip() for name in felt.split(",") if name.strip()]
    if not names:
        raise TableError("--felt names no zone; give at least one, such as --felt I,III")
    with open_table(table_path) as table:
        entry = table.entry_for(names)
        if as_json:
            _print_json(_entry_json(table, entry))
        else:
            _print_entry(table, entry)


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
    figure: Annotated[Path, typer.Option("--figure", help="Where the picture goes.")] = Path("tactable-demo.png"),
    as_json: AsJson = False,
) -> None:
    """Touches to felt zones without hardware, and whether the simulated bar does what the table promised."""
    from tactable.demo import demo_json, run_demo, table_for
    from tactable.demo_page import print_demo
    from tactable.plots import draw_demo

    device = find_device(device_name)
    recording = read_recording(recording_path or DEMO_RECORDING)
    path = table_path or _cache_folder() / f"{device.name}-{device.fingerprint[:12]}.nc"
    with _progress(as_json) as progress:
        table = table_for(device, path, progress)
    with table:
        report = run_demo(table, recording)
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
    from tactable.bench_sweep import print_sweep_bench, run_sweep_bench

    result = run_sweep_bench(find_device(device_name))
    if as_json:
        _print_json(result)
    else:
        print_sweep_bench(_out, result)


@bench.command("decode")
def bench_decode(
    recordings: Annotated[
        list[Path] | None, typer.Argument(help="In hid-recorder form; default: the shipped one.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """How long the decoder takes for a report."""
    from tactable.bench_decode import print_decode_bench, run_decode_bench

    result = run_decode_bench(recordings or [DEMO_RECORDING])
    if as_json:
        _print_json(result)
    else:
        print_decode_bench(_out, result)


def _entry_json(table: Table, entry: Entry) -> dict[str, Any]:
    return {
        "device": table.device.name,
        "fingerprint": table.fingerprint,
        "state": entry.index,
        "drive": {
            "frequencies_hz": list(entry.frequencies_hz),
            "amplitudes": list(entry.amplitudes),
            "phases_rad": list(entry.phases_rad),
        },
        "family": entry.family,
        "achieved": entry.achieved,
        "localized_factor": entry.localized_factor,
        "upper_bound": entry.upper_bound,
        "contrast_db": entry.contrast_db,
        "t90_s": entry.t90_s,
        "limited_by": entry.limited_by,
        "zones": [
            {
                "name": zone.name,
                "state": zone.state.name.lower(),
                "share": zone.share,
                "peak_acceleration_m_per_s2": zone.peak_acceleration_m_per_s2,
                "peak_position_m": zone.peak_position_m,
                "dead_acceleration_m_per_s2": zone.dead_acceleration_m_per_s2,
                "dead_position_m": zone.dead_position_m,
            }
            for zone in entry.zones
        ],
        "estimated": list(table.device.inferred),
    }


def _print_entry(table: Table, entry: Entry) -> None:
    felt = ", ".join(zone.name for zone in entry.zones if zone.state.name == "FELT")
    _out.print(f"{table.device.name}, felt {felt}: {entry.family}, bar untouched")
    for actuator, hz, amplitude, phase in zip(
        table.device.actuators, entry.frequencies_hz, entry.amplitudes, entry.phases_rad, strict=True
    ):
        drive = f"{hz:.2f} Hz at {100 * amplitude:.1f} %, {phase:+.3f} rad" if amplitude else "still"
        _out.print(f"  {actuator.name}: {drive}", markup=False, highlight=False)
    contrast = "" if entry.contrast_db is None else f", contrast {entry.contrast_db:.1f} dB"
    bound = f"no drive passes {entry.upper_bound:.4f}"
    _out.print(f"localized factor {entry.localized_factor:.4f} ({bound}){contrast}, t90 {1e3 * entry.t90_s:.0f} ms")
    _out.print(f"limited by: {entry.limited_by}{'' if entry.achieved else ' - NOT ACHIEVED, the best possible'}")
    grid = Grid("zone", "state", "share", "peak m/s²", "at mm", "least m/s²", "at mm")
    for zone in entry.zones:
        figures = (zone.peak_acceleration_m_per_s2, 1e3 * zone.peak_position_m)
        least = (zone.dead_acceleration_m_per_s2, 1e3 * zone.dead_position_m)
        state = zone.state.name.lower()
        cells = (f"{zone.share:.3f}", f"{figures[0]:.2f}", f"{figures[1]:.1f}", f"{least[0]:.2f}", f"{least[1]:.1f}")
        grid.add_row(zone.name, state, *cells)
    _out.print(grid)
    _out.print(f"ESTIMATES in the device: {', '.join(table.device.inferred) or 'none'}", style="dim")


def _print_json(value: object) -> None:
    print(json.dumps(value, indent=2))  # noqa: T201  # JSON goes out as it is, without a terminal's width


@contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[str, float], None]]:
    """A progress bar with the time that is left, on standard error."""
    columns = (TextColumn("{task.description:>16}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=_errors, transient=True, disable=quiet or not _errors.is_terminal) as shown:
        task = shown.add_task("starting", total=1.0)
        yield lambda step, fraction: shown.update(task, description=step, completed=fraction)


def _cache_folder() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "tactable"


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
