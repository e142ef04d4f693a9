"""The commands around the link: emulate."""

import json
import secrets
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from firmware_link.emulator.fault_plan import fault_help, parse_fault_plan
from tactable.rig.emulate import Emulated, configuration_of, emulate
from tactable.shipped import find_device

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON for machines, a line for each port and the end.")]
_out = Console()


def register(app: typer.Typer) -> None:
    """Add the commands to `app`."""

    @app.command("emulate")
    def emulate_command(
        faults: Annotated[str, typer.Option(metavar="SPEC", help="Faults to inject; `help` lists them.")] = "",
        seed: Annotated[int | None, typer.Option(help="The same seed gives the same faults.")] = None,
        device_name: Annotated[
            str | None, typer.Option("--device", help="Full scales and actuators of a device file or shipped name.")
        ] = None,
        core: Annotated[
            Path | None, typer.Option(metavar="LIBRARY", help="The firmware's C core, built with make host.")
        ] = None,
        link: Annotated[
            Path | None, typer.Option(metavar="PATH", help="Where a symbolic link to the port shall be meanwhile.")
        ] = None,
        as_json: AsJson = False,
    ) -> None:
        """Be a device on a serial port, SIMULATED, until Ctrl-C."""
        if faults == "help":
            _print_fault_help(as_json)
            return
        plan = parse_fault_plan(faults)
        configuration = configuration_of(None if device_name is None else find_device(device_name))
        chosen_seed = secrets.randbits(32) if seed is None else seed
        summary = emulate(configuration, plan, chosen_seed, _print_port_json if as_json else _print_port, core, link)
        if as_json:
            _print_line(summary)
        else:
            _print_summary(summary)


def _print_fault_help(as_json: bool) -> None:
    if as_json:
        _print_line(fault_help())
        return
    for key, text in fault_help().items():
        _out.print(f"{key:>10}  {text}", markup=False, highlight=False, soft_wrap=True)


def _print_port(emulated: Emulated) -> None:
    _out.print(f"port {emulated.port}, and whatever it is called later {emulated.stable_name}", highlight=False)
    _out.print(
        f"{emulated.number_of_actuators} actuators, seed {emulated.seed}, SIMULATED; Ctrl-C ends", highlight=False
    )


def _print_port_json(emulated: Emulated) -> None:
    _print_line({"simulated": True, **asdict(emulated)})


def _print_summary(summary: dict[str, Any]) -> None:
    for index, counters in enumerate(summary["boots"]):
        _out.print(f"boot {index + 1}: {_counts(counters)}", highlight=False, soft_wrap=True)
    _out.print(f"faults: {_counts(summary['faults'])}", highlight=False, soft_wrap=True)


def _counts(counters: dict[str, int]) -> str:
    return ", ".join(f"{name} {number}" for name, number in counters.items() if number) or "none"


def _print_line(document: dict[str, Any]) -> None:
    print(json.dumps(document), flush=True)  # noqa: T201  # JSON goes out as it is, a line at a time
