"""The commands around touch devices: list, record, doctor, map."""

import json
import math
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table as Grid

from engine.loop.loop import SystemClock
from engine.touch.sources.recording import write_recording
from tactable.digitizers.axis_map import LearntAxis, digitizer_table
from tactable.digitizers.listing import list_devices
from tactable.digitizers.record import learn_from_recording, learn_live, opened, record_source, stop_at_signal
from tactable.doctor.check import Check
from tactable.doctor.layers import check_layers, measure_layers
from tactable.doctor.machine import check_machine
from tactable.doctor.tables import check_fast_path, check_kernels, check_tables
from tactable.doctor.touch import Machine, examine, rules_text
from tactable.shipped import cache_folder, find_device

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON for machines.")]
DeviceOption = Annotated[
    str, typer.Argument(metavar="DEVICE", help="Path, stable id, serial number or vendor:product, as `list` shows.")
]
_out = Console()
_errors = Console(stderr=True)


def register(app: typer.Typer, machine: Machine | None = None) -> None:
    """Add the commands to `app`; they ask `machine`, by default the one they run on."""
    asked = machine or Machine()

    @app.command("list")
    def list_command(as_json: AsJson = False) -> None:
        """Digitizers and serial ports of this machine, each with a name that stays the same."""
        listing = list_devices(asked)
        if as_json:
            _print_json(listing)
        else:
            _print_listing(listing)

    @app.command()
    def record(
        device: DeviceOption,
        output: Annotated[Path, typer.Option("-o", "--output", help="The recording, in hid-recorder form.")],
        seconds: Annotated[float, typer.Option(min=0.0, help="End after this time; default: at Ctrl-C.")] = math.inf,
        as_json: AsJson = False,
    ) -> None:
        """Record what a digitizer reports, until Ctrl-C or until it is unplugged."""
        with opened(asked, device) as (source, bus), stop_at_signal() as stop:
            _errors.print(f"recording {source.name}; touch it, Ctrl-C ends", markup=False)
            recording = record_source(source, bus, SystemClock(), stop, seconds)
        write_recording(recording, output)
        duration_s = recording.reports[-1].time_s if recording.reports else 0.0
        summary = {"recording": str(output), "name": recording.name, "reports": len(recording.reports)}
        if as_json:
            _print_json({**summary, "duration_s": duration_s})
        else:
            _out.print(f"{output}: {len(recording.reports)} reports in {duration_s:.1f} s", markup=False)

    @app.command()
    def doctor(
        device: Annotated[
            str | None, typer.Argument(help="With --emit-udev: the digitizer or serial port; default: all.")
        ] = None,
        emit_udev: Annotated[bool, typer.Option("--emit-udev", help="Print the udev rule, and nothing else.")] = False,
        tables: Annotated[
            list[Path] | None, typer.Option("--table", help="Also this table; default: those in this folder.")
        ] = None,
        bit_rate_hz: Annotated[int, typer.Option("--bit-rate", min=1, help="The port will have, bit/s.")] = 115_200,
        measures: Annotated[bool, typer.Option("--measure/--no-measure", help="Which layer costs most.")] = True,
        as_json: AsJson = False,
    ) -> None:
        """Look whether touches can be read and commands be written here, how fast, and what to do about it.

        Exit status 1 where something fails; what is only slow is told.
        """
        if emit_udev:
            rules = rules_text(asked, device)
            if as_json:
                _print_json({"rules": rules})
            else:
                print(rules)  # noqa: T201  # for a file
            return
        checks = [
            *examine(asked),
            *check_machine(asked.files),
            *check_tables(tables or sorted(Path().glob("*.nc"))),
            check_kernels(),
            check_fast_path(cache_folder()),
            *(check_layers(measure_layers(bit_rate_hz)) if measures else ()),
        ]
        if as_json:
            _print_json([{**asdict(check), "passed": check.passed} for check in checks])
        else:
            _print_checks(checks)
        if not all(check.passed or not check.needed for check in checks):
            raise typer.Exit(1)

    @app.command("map")
    def map_command(
        name: Annotated[str, typer.Argument(metavar="DEVICE_OR_RECORDING", help="A digitizer, or a recording of one.")],
        device_name: Annotated[
            str | None, typer.Option("--device", help="The bar's device file or shipped name, for its length.")
        ] = None,
        as_json: AsJson = False,
    ) -> None:
        """Learn how the digitizer lies on the bar: draw one finger along it, from its start to its end."""
        bar_mm = None if device_name is None else 1e3 * find_device(device_name).bar.length_m
        path = Path(name)
        if path.is_file():
            learnt = learn_from_recording(path, bar_mm)
        else:
            _errors.print("draw one finger along the bar, from its start to its end; Ctrl-C ends")
            learnt = learn_live(asked, name, bar_mm)
        if as_json:
            _print_json(map_json(learnt))
        else:
            print(digitizer_table(learnt))  # noqa: T201  # for a file
        for note in learnt.notes:
            _errors.print(f"note: {note}", style="yellow", markup=False, soft_wrap=True)


def _print_listing(listing: dict[str, list[Any]]) -> None:
    grid = Grid("digitizer", "choose it by", "by", "size mm", "contacts", "usable")
    for row in listing["digitizers"]:
        sizes = [row["width_mm"], row["height_mm"]]
        size = " x ".join("?" if length is None else f"{length:.0f}" for length in sizes)
        maximum = "?" if row["contact_maximum"] is None else str(row["contact_maximum"])
        cells = (row["name"], row["stable_id"], row["source"], size, maximum, "yes" if row["usable"] else "NO")
        grid.add_row(*map(_plain, cells))
    _out.print(grid)
    for problem in (*(row["problem"] for row in listing["digitizers"] if row["problem"]), *listing["problems"]):
        _out.print(problem, style="yellow", markup=False, soft_wrap=True)
    ports = Grid("serial port", "choose it by", "what it says")
    for row in listing["serial_ports"]:
        ports.add_row(row["path"], _plain(row["stable_id"]), _plain(row["description"]))
    if listing["serial_ports"]:
        _out.print(ports)
    else:
        _out.print("no serial port")


def _plain(text: str) -> str:
    """Text of a device in a table: its brackets are no markup."""
    return text.replace("[", r"\[")


def map_json(learnt: LearntAxis) -> dict[str, Any]:
    """What was learnt, for machines; lengths are None where neither bar nor device states one."""
    bar_mm = learnt.bar_mm
    return {
        "axis": learnt.axis,
        "flip": learnt.flip,
        "start_margin": learnt.margin_text(learnt.start_margin),
        "end_margin": learnt.margin_text(learnt.end_margin),
        "start_margin_mm": None if bar_mm is None else learnt.start_margin * bar_mm,
        "end_margin_mm": None if bar_mm is None else learnt.end_margin * bar_mm,
        "bar_mm": bar_mm,
        "touch_mm": learnt.touch_mm,
        "logical_at_start": learnt.first,
        "logical_at_end": learnt.last,
        "notes": list(learnt.notes),
        "table": digitizer_table(learnt),
    }


# ---- doctor ----------------------------------------------------------------------------------------------


def _print_checks(checks: list[Check]) -> None:
    for check in checks:
        mark, style = ("ok  ", "green") if check.passed else ("FAIL", "red") if check.needed else ("slow", "yellow")
        _out.print(f"{mark} {check.name}: {check.finding}", style=style, markup=False, soft_wrap=True)
        if not check.passed:
            _out.print(f"     {check.remedy}", markup=False, soft_wrap=True)


def _print_json(value: object) -> None:
    json.dump(value, sys.stdout, indent=2)
    sys.stdout.write("\n")
