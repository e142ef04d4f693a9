"""Commands `bench ...`: each runs one benchmark, and prints its page or its JSON."""

from pathlib import Path
from typing import Annotated

import typer

from tactable.cli.console import show
from tactable.cli.options import AsJson, DeviceOption, OptionalTable
from tactable.shipped import DEMO_RECORDING, find_device, named_effects


def sweep(device_name: DeviceOption = "reference-a", as_json: AsJson = False) -> None:
    """Time the sweep over frequencies and amplitudes.

    It is compared with NumPy, with the solution point by point, and with the time to write the same memory.
    """
    from tactable.bench.sweep import print_sweep_bench, run_sweep_bench

    show(run_sweep_bench(find_device(device_name)), as_json, print_sweep_bench)


def step(
    table_path: OptionalTable = None,
    recordings: Annotated[
        list[Path] | None, typer.Option("--recording", help="In hid-recorder format; default: the shipped one.")
    ] = None,
    effects_path: Annotated[
        Path | None,
        typer.Option("--effects", help="Also with the rules of this file, such as tables/effects/slider.toml."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Time the stages from a report to command bytes.

    Drives for positions and for zones, and clicks are timed, with and without rules, beside the compiled step.
    """
    from engine.effects.rule_file import read_effects
    from engine.touch.sources.recording import read_recording
    from tactable.bench.inputs import open_table
    from tactable.bench.step import RULES, print_step_bench, run_step_bench

    read = {path.name: read_recording(path) for path in recordings or [DEMO_RECORDING]}
    with open_table(table_path) as table:
        rules = dict(RULES)
        if effects_path is not None:
            rules[effects_path.name] = read_effects(effects_path, table.device, named_effects())
        show(run_step_bench(table, read, rules), as_json, print_step_bench)


def control(
    table_path: OptionalTable = None,
    rounds: Annotated[int, typer.Option(min=10, help="Touches and messages of each kind.")] = 1000,
    as_json: AsJson = False,
) -> None:
    """Time a program's message to command bytes, beside touches.

    Messages of a program and touches take turns in the same run, and bring the same clicks. A pause follows
    each click: 1000 rounds, with the compiled step and then without, pause for two and a half minutes in all.
    """
    from tactable.bench.control_bench import print_control_bench, run_control_bench
    from tactable.bench.inputs import open_table

    with open_table(table_path) as table:
        show(run_control_bench(table, rounds), as_json, print_control_bench)
