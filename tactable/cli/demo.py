"""Commands that need no hardware: the demo, and the emulated firmware on a serial port. Both say SIMULATED."""

import contextlib
import os
import secrets
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from base.files import remove_all_partials
from tactable.cli import options
from tactable.cli.console import EXIT_DOUBTFUL, print_json, remark, say, show, shown_progress
from tactable.shipped import DEMO_RECORDING, cache_folder, find_device, find_device_file

if TYPE_CHECKING:
    from engine.device import Device
    from tactable.rig.accelerometer import SensedSurface
    from tactable.rig.emulate import Emulated

_BEFORE_OTHERS = -10  # niceness of an emulated bar, which must keep up with the clock


def demo(
    context: typer.Context,
    device_name: Annotated[str, typer.Argument(metavar="DEVICE", help=options.DEVICE_HELP)] = "reference-a",
    recording_path: Annotated[
        Path | None, typer.Option("--recording", help="Touches in hid-recorder format; default: the shipped ones.")
    ] = None,
    table_path: Annotated[
        Path | None, typer.Option("--table", help="The table, built if it is missing; default: in a cache.")
    ] = None,
    rules_path: options.RulesPath = None,
    drives: options.DrivesOf = None,
    figure: Annotated[
        Path | None, typer.Option("--figure", help="The report's picture; default: tactable-demo.png.")
    ] = None,
    headless: Annotated[bool, typer.Option("--headless", help="No page: play recorded touches and report.")] = False,
    no_open: Annotated[bool, typer.Option("--no-open", help="Print the page's address and open no browser.")] = False,
    host: Annotated[
        str | None,
        typer.Option("--host", help="Bind the page to this address instead of 127.0.0.1, and print a QR code of it."),
    ] = None,
    page_port: Annotated[int, typer.Option("--page-port", min=0, max=65_535, help="The page's port; 0: any.")] = 0,
    control: Annotated[bool, typer.Option("--control", help="Let programs decide who feels what on the page.")] = False,
    control_socket: options.ControlSocket = None,
    control_port: options.ControlPort = None,
    control_osc: options.ControlOsc = None,
    as_json: options.AsJson = False,
) -> None:
    """Show the whole chain, SIMULATED: as a page to touch, or as a report.

    The report compares what the table predicts with what the simulated bar does; exit status 3: they disagree. It
    takes the page's place without a browser, and with --headless, --json, --figure, --recording or --table.
    """
    from tactable.rig.ready import take_built

    options.need_switch(context, "--control", control, "control_socket", "control_port", "control_osc")
    device, device_file = find_device(device_name), find_device_file(device_name)
    remove_all_partials(cache_folder())
    if device_file == Path(device_name) and (built := take_built(device, device_file, cache_folder())):
        remark(f"plays {built}")
    is_report = headless or as_json or any(path is not None for path in (figure, recording_path, table_path))
    is_asked_for = no_open or host is not None or page_port != 0 or control
    if is_report and is_asked_for:
        raise typer.BadParameter(
            "--no-open, --host, --page-port and --control are the page's, and --headless, --json, --figure, "
            "--recording and --table ask for the report instead: give options of one of the two"
        )
    if not is_report:
        from tactable.control.client import default_socket
        from tactable.page.opening import Address, has_browser, show_demo
        from tactable.page.processes.engine_process import ProgramsAt

        opens_browser = not no_open and host is None and has_browser()
        if opens_browser or is_asked_for:
            if drives is not None and rules_path is not None:
                raise options.OptionError(
                    "--drives: the page plays the rule file as it is; write its key `drives` in place of it"
                )
            socket = str((control_socket or default_socket()).absolute())
            programs = ProgramsAt(socket, control_port, control_osc) if control else None
            first = None if drives is None else options.read_drives_of(drives)
            address = Address(host or "127.0.0.1", page_port, opens_browser)
            show_demo(device_name, device, rules_path, cache_folder(), address, remark, first, programs)
            return
        remark("no browser here: the report instead of the page; --no-open prints an address to open elsewhere")
    report_demo(device, recording_path, table_path, rules_path, drives, figure or Path("tactable-demo.png"), as_json)


def report_demo(
    device: "Device",
    recording_path: Path | None,
    table_path: Path | None,
    rules_path: Path | None,
    drives: str | None,
    figure: Path,
    as_json: bool,
) -> None:
    """Play a recording through the simulated chain, draw and print what came of it."""
    from engine.touch.sources.recording import read_recording
    from tactable.figures.demo_picture import draw_demo
    from tactable.figures.picture_file import outputs_of
    from tactable.rig.demo_page import print_demo
    from tactable.rig.demo_run import demo_json, run_demo, table_at, table_for
    from tactable.rig.ready import cached_table, compare_with_shipped, open_shipped

    outputs_of([figure])
    if table_path is not None and table_path.exists() and not table_path.is_file():
        raise options.OptionError(
            f"--table {table_path}: is not a plain file; name a table, or one that is to be built"
        )
    recording = read_recording(recording_path or DEMO_RECORDING)
    effects = options.read_rules(rules_path, device, drives)
    cached = cached_table(device, cache_folder())
    shipped, shipped_s = open_shipped(device, cached), _processor_s()
    with shown_progress(as_json) as progress:
        table = table_for(device, cached, progress) if table_path is None else table_at(device, table_path, progress)
    beside: dict[str, Any] | None = None
    if shipped is not None:
        found, built_s = compare_with_shipped(shipped, table), _processor_s()
        shipped.close()
        beside = {"usable_after_processor_s": shipped_s, "built_after_processor_s": built_s, **found.as_json()}
        remark(f"shipped table: usable after {shipped_s:.1f} s of processor time; the same built here: {built_s:.1f} s")
        remark(f"compared with the shipped one: {found.text}")
    with table:
        report = run_demo(table, recording, effects)
    draw_demo(report, figure)
    document = {**demo_json(report), "figure": str(figure), "shipped_table": beside}
    show(document, as_json, lambda out, _: print_demo(out, report, figure))
    if not report.agrees:
        raise typer.Exit(EXIT_DOUBTFUL)


def _processor_s() -> float:
    """Processor time of this command and its processes that have ended."""
    return sum(os.times()[:4])


def emulate(
    faults: Annotated[str, typer.Option(metavar="SPEC", help="Faults to inject; `help` lists them.")] = "",
    seed: Annotated[int | None, typer.Option(help="Seed of the faults; the same seed gives the same ones.")] = None,
    device_name: Annotated[
        str | None, typer.Option("--device", help="Full scales and actuators of a device file or shipped name.")
    ] = None,
    core: Annotated[
        Path | None, typer.Option(metavar="LIBRARY", help="The firmware's C core, built with make host.")
    ] = None,
    link: Annotated[
        Path | None, typer.Option(metavar="PATH", help="Make a symbolic link to the port here, for as long as it runs.")
    ] = None,
    accelerometer: Annotated[
        str,
        typer.Option(
            "--sensor", metavar="SPEC", help="Accelerometer of the board, as at=35mm,mass=2g; on a plate at=35x60mm."
        ),
    ] = "",
    as_json: options.AsJson = False,
) -> None:
    """Emulate the firmware on a serial port, SIMULATED.

    With --sensor the board has an ADXL345 on the simulated surface of --device, which `measure --sensor board:35mm`
    reads.

    It runs until Ctrl-C. With --json it prints a line for each port and one at the end.
    """
    from threadpoolctl import threadpool_limits

    from firmware_link.emulator.fault_plan import fault_help, parse_fault_plan
    from tactable.rig.emulate import configuration_of
    from tactable.rig.emulate import emulate as run_emulator

    if faults == "help":
        if as_json:
            print_json(fault_help(), indent=None)
        for key, text in () if as_json else fault_help().items():
            say(f"{key:>10}  {text}")
        return
    plan = parse_fault_plan(faults)
    device = None if device_name is None else find_device(device_name)
    configuration = configuration_of(device)
    chosen_seed = secrets.randbits(32) if seed is None else seed
    bar = _sensed_bar(device, accelerometer, core, chosen_seed) if accelerometer else None
    if bar is not None:
        with contextlib.suppress(PermissionError):  # a board is not slowed down by what else its host has to do
            os.nice(_BEFORE_OTHERS)

    def print_port(emulated: "Emulated") -> None:
        if as_json:
            print_json({"simulated": True, **asdict(emulated)}, indent=None)
        else:
            say(f"port {emulated.port}, whose stable name is {emulated.stable_name}")
            say(f"{emulated.number_of_actuators} actuators, seed {emulated.seed}, SIMULATED; Ctrl-C ends")

    with threadpool_limits(1, "blas"):  # its threads spin, and the emulated bar must keep up with the clock
        summary = run_emulator(configuration, plan, chosen_seed, print_port, core, link, bar)
    if as_json:
        print_json(summary, indent=None)
        return
    for index, counters in enumerate(summary["boots"], 1):
        say(f"boot {index}: {_counts(counters)}")
    say(f"faults: {_counts(summary['faults'])}")


def _sensed_bar(device: "Device | None", text: str, core: Path | None, seed: int) -> "SensedSurface":
    """The surface with the accelerometer of a text. Raises OptionError, AccelerometerError."""
    from tactable.rig.accelerometer import EmulatedAccelerometer, SensedSurface

    if device is None:
        raise options.OptionError("--sensor: an accelerometer lies on a surface; give it by --device")
    if core is not None:
        raise options.OptionError("--sensor: only the firmware's Python twin has a simulated surface; leave --core out")
    return SensedSurface(device, EmulatedAccelerometer.parse(text), seed)


def _counts(counters: dict[str, Any]) -> str:
    return ", ".join(f"{name} {number}" for name, number in counters.items() if number) or "none"
