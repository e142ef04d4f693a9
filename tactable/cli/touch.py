"""Commands around touch digitizers: list, doctor, map, record, replay."""

import math
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table as Grid
from typer import Argument, Option

from base.points import sides_of
from firmware_link import BIT_RATE_HZ
from tactable.cli.console import ERRORS, OUT, note, print_json, say, show
from tactable.cli.options import AsJson, BitRate, OptionError, need_switch
from tactable.digitizers.axis_map import LearntAxis, digitizer_table, write_digitizer
from tactable.digitizers.listing import list_devices as find_devices
from tactable.doctor.touch_check import Machine
from tactable.shipped import cache_folder, find_device

if TYPE_CHECKING:
    from engine.device import TouchAxis

DigitizerName = Annotated[
    str, Argument(metavar="PANEL", help="Path, stable id, serial number or vendor:product, as in `tactable list`.")
]


def machine_of(context: typer.Context) -> Machine:
    """The machine that the commands ask: this one, or the one that the caller of the command line handed in."""
    return context.obj if isinstance(context.obj, Machine) else Machine()


def list_devices(context: typer.Context, as_json: AsJson = False) -> None:
    """List the touch digitizers, serial ports and sound cards of this machine.

    Each has a name that stays the same when it is plugged into another port.
    """
    show(find_devices(machine_of(context)), as_json, lambda _, listing: _print_listing(listing))


def record(
    context: typer.Context,
    device: DigitizerName,
    output: Annotated[Path, Option("-o", "--output", help="The recording, in hid-recorder format.")],
    seconds: Annotated[float, Option(min=0.0, help="End after this time; default: at Ctrl-C.")] = math.inf,
    as_json: AsJson = False,
) -> None:
    """Record what a digitizer reports.

    The recording ends at Ctrl-C, after --seconds, or when the digitizer is unplugged.
    """
    from base.files import check_folder_of
    from engine.loop.loop import SystemClock
    from engine.touch.sources.recording import write_recording
    from tactable.digitizers.record import opened, record_source, stop_at_signal

    check_folder_of(output)
    with opened(machine_of(context), device) as (source, bus), stop_at_signal() as stop:
        ERRORS.print(f"recording {source.name}; touch it, Ctrl-C ends")
        recording = record_source(source, bus, SystemClock(), stop, seconds)
    write_recording(recording, output)
    duration_s = recording.reports[-1].time_s if recording.reports else 0.0
    count = len(recording.reports)
    summary = {"recording": str(output), "name": recording.name, "reports": count, "duration_s": duration_s}
    show(summary, as_json, lambda *_: say(f"{output}: {count} reports in {duration_s:.1f} s"))


def replay(
    recording_name: Annotated[
        str, Argument(metavar="RECORDING", help="A recording (hid-recorder, evemu, libinput); FILE#38 of one surface.")
    ],
    frames: Annotated[bool, Option("--frames", help="Print every complete touch frame.")] = False,
    device_name: Annotated[
        str | None, Option("--device", help="The device file or shipped name, for its `silence` and `debounce`.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Decode a recording as the engine does, all at once.

    A frame without a report was brought by time.
    """
    from engine.touch import open_digitizer
    from engine.touch.debounce import fit_releases
    from engine.touch.sources.recording import read_recording
    from tactable.digitizers.record import recorded_frames, recording_named

    path, report_id = recording_named(recording_name) or (Path(recording_name), None)
    recording = read_recording(path)
    digitizer = open_digitizer(recording.descriptor, recording.vendor_id, recording.product_id, report_id)
    if device_name is not None:
        digitizer.on_surface = partial(fit_releases, digitizer, find_device(device_name))
        digitizer.on_surface()
    completed = 0
    for index, frame in recorded_frames(digitizer, recording):
        completed += index is not None
        time_s = frame.time_ns / 1e9
        contacts = [
            {"id": c.contact_id, "x": c.x, "y": c.y, "tip": c.tip, "palm": not c.confidence} for c in frame.contacts
        ]
        if frames and as_json:
            print_json({"report": index, "t_s": time_s, "contacts": contacts}, indent=None)
        elif frames:
            shown = "  ".join(
                f"{c['id']}: {c['x']},{c['y']}{'' if c['tip'] else ' hovers'}{' palm' if c['palm'] else ''}"
                for c in contacts
            )
            say(f"{'time' if index is None else index:>6} {time_s:10.4f} s  {shown or 'nothing'}")
    if digitizer.foreign_notice:
        note(digitizer.foreign_notice)
    if frames:
        return
    surface, count = digitizer.surface, len(recording.reports)
    if as_json:
        which = {"kind": surface.kind.name, "surface": surface.name(recording.vendor_id, recording.product_id)}
        print_json({"name": recording.name, **which, "reports": count, "touch_frames": completed})
    else:
        say(f"{recording.name}: {surface.label}, {count} reports, {completed} touch frames")


def doctor(
    context: typer.Context,
    device: Annotated[str | None, Argument(help="With --emit-udev: a digitizer or serial port; default: all.")] = None,
    emit_udev: Annotated[bool, Option("--emit-udev", help="Print the udev rule, and nothing else.")] = False,
    tables: Annotated[list[Path] | None, Option("--table", help="A table to check; default: those here.")] = None,
    bit_rate_hz: BitRate = BIT_RATE_HZ,
    measures: Annotated[bool, Option("--measure/--no-measure", help="Measure which layer is slowest.")] = True,
    as_json: AsJson = False,
) -> None:
    """Check whether touches can be read and commands written, and how fast.

    Every check that does not pass comes with its remedy. Exit status 1: a needed check failed; a slow one does not
    count as failed.
    """
    from tactable.doctor.layers import layers_of
    from tactable.doctor.ports import check_cards, check_machine
    from tactable.doctor.table_check import check_fast_path, check_kernels, check_tables
    from tactable.doctor.touch_check import examine, rules_text

    need_switch(context, "--emit-udev", emit_udev, "device")
    machine = machine_of(context)
    if emit_udev:
        rules = rules_text(machine, device)
        if as_json:
            print_json({"rules": rules})
        else:
            print(rules)  # noqa: T201  # for a file
        return
    looked_at = tables or sorted(Path().glob("*.nc"))
    whole, *layers = layers_of(bit_rate_hz, next(iter(looked_at), None)) if measures else (None,)
    checks = [
        *([] if whole is None else [whole]),
        *examine(machine),
        *check_cards(machine.cards),
        *check_machine(machine.files),
        *check_tables(looked_at),
        check_kernels(),
        check_fast_path(cache_folder()),
        *layers,
    ]
    if as_json:
        print_json([{**asdict(check), "passed": check.passed} for check in checks])
    for check in () if as_json else checks:
        mark, style = ("ok  ", "green") if check.passed else ("FAIL", "red") if check.needed else ("note", "yellow")
        OUT.print(f"{mark} {check.name}: {check.finding}", style=style, soft_wrap=True)
        if not check.passed:
            OUT.print(f"     {check.remedy}", soft_wrap=True)
    if not all(check.passed or not check.needed for check in checks):
        raise typer.Exit(1)


def map_axis(
    context: typer.Context,
    name: Annotated[str, Argument(metavar="PANEL|RECORDING", help="A digitizer, or a recording of one.")],
    device_name: Annotated[
        str | None, Option("--device", help="The device file or shipped name, for the sides of its surface.")
    ] = None,
    writes: Annotated[bool, Option("--write", help="Write the table into the file of --device.")] = False,
    as_json: AsJson = False,
) -> None:
    """Learn how the digitizer lies on the surface from strokes of a finger.

    Draw from the bar's start to its end. On a plate draw twice from its first corner: along it, then across it. What is
    printed is the [digitizer] table of the device file.
    """
    if writes and not (device_name and Path(device_name).is_file()):
        raise OptionError("--write: needs the device file to write to: give it by --device")
    from tactable.digitizers.record import learn_from_recording, learn_live, recording_named

    device = None if device_name is None else find_device(device_name)
    sides_mm: list[float | None] = [None]
    where = "along the bar, from its start to its end"
    if device is not None:
        sides_mm = [1e3 * side_m for side_m in sides_of(device.surface.corner_m) if not math.isnan(side_m)]
        if len(sides_mm) > 1:
            where = "along the plate from its first corner, lift it, then draw across the plate from there"
    recorded = recording_named(name)
    if recorded is not None:
        learnt = learn_from_recording(recorded[0], sides_mm, recorded[1])
    else:
        ERRORS.print(f"draw one finger {where}; Ctrl-C ends")
        learnt = learn_live(machine_of(context), name, sides_mm, note)
    before = None if device is None else device.touch_axis
    if as_json:
        print_json(map_json(learnt, before))
    else:
        print(digitizer_table(learnt, before))  # noqa: T201  # for a file
    if writes and device_name:
        write_digitizer(Path(device_name), digitizer_table(learnt, before))
        note(f"written into {device_name}; a table that was built of it is stale: build it again")
    for text in (*learnt.notes, *(f"across: {text}" for text in (learnt.across.notes if learnt.across else ()))):
        note(text)


def _print_listing(listing: dict[str, list[Any]]) -> None:
    grid = Grid("digitizer", "choose it by", "by", "size mm", "contacts", "usable")
    for row in listing["digitizers"]:
        sizes = [row["width_mm"], row["height_mm"]]
        size = " x ".join("?" if length is None else f"{length:.0f}" for length in sizes)
        maximum = "?" if row["contact_maximum"] is None else str(row["contact_maximum"])
        cells = (row["name"], row["stable_id"], row["source"], size, maximum, "yes" if row["usable"] else "NO")
        grid.add_row(*cells)
    OUT.print(grid)
    for problem in (*(row["problem"] for row in listing["digitizers"] if row["problem"]), *listing["problems"]):
        OUT.print(problem, style="yellow", soft_wrap=True)
    ports = Grid("serial port", "choose it by", "what it says")
    for row in listing["serial_ports"]:
        ports.add_row(row["path"], row["stable_id"], row["description"])
    OUT.print(ports if listing["serial_ports"] else "no serial port")
    cards = Grid("sound card", "choose it by", "outputs", "inputs", "to the output")
    for row in listing["sound_cards"]:
        channels = (str(row["outputs"]), str(row["inputs"]))
        cards.add_row(row["name"], row["choose_by"], *channels, f"{row['output_latency_ms']:.1f} ms")
    OUT.print(cards)


def map_json(learnt: LearntAxis, before: "TouchAxis | None") -> dict[str, Any]:
    """Return the learnt axis for JSON; a length that neither the device file nor the digitizer states is null."""
    across = None if learnt.across is None else _axis_json(learnt.across)
    return {**_axis_json(learnt), "across": across, "table": digitizer_table(learnt, before)}


def _axis_json(learnt: LearntAxis) -> dict[str, Any]:
    length_mm = learnt.length_mm
    return {
        "axis": learnt.axis,
        "flip": learnt.flip,
        "start_margin": learnt.margin_text(learnt.start_margin),
        "end_margin": learnt.margin_text(learnt.end_margin),
        "start_margin_mm": None if length_mm is None else learnt.start_margin * length_mm,
        "end_margin_mm": None if length_mm is None else learnt.end_margin * length_mm,
        "bar_mm": length_mm,
        "touch_mm": learnt.touch_mm,
        "logical_at_start": learnt.first,
        "logical_at_end": learnt.last,
        "notes": list(learnt.notes),
    }
