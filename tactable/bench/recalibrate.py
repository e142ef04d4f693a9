"""How long it takes from measurements to the new table playing, and what each change of table costs the run."""

import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table as Grid

from tactable.bench.latency.load import Load
from tactable.rig.swap_run import measure_changes, resting_run
from tactable.shipped import find_device, find_device_file
from tactable.step_times import times_text

TACTABLE = (sys.executable, "-c", "from tactable.cli.main import main; main()")
_STIFFNESS = ("18.9 kN/m", "20.5 kN/m")
_ROWS = {
    "reports": "reports at 1000 a second",
    "reports_lost": "reports lost",
    "reports_63_ms_late": "reports read 63 ms late or later: a hidraw device would have lost some",
    "commands": "commands",
    "commands_late": "commands a frame period (1 ms) late or later",
    "commands_late_percent": "the same, %",
    "command_p50_ms": "due to written, median, ms",
    "command_p99_ms": "due to written, 99 %, ms",
    "command_max_ms": "due to written, greatest, ms",
}
_DRIFT = ("actuator[1].stiffness=20.5 kN/m", "actuator.full_scale=0.48 µm")
_out = Console()


def register(bench: typer.Typer) -> None:
    """Add the command to the benchmarks."""

    @bench.command("recalibrate")
    def bench_recalibrate(
        device_name: Annotated[str, typer.Option("--device", help="A device file, or a shipped name.")] = "reference-a",
        swaps: Annotated[int, typer.Option(min=0, help="Changes of table while touches come; some 1 s each.")] = 1000,
        load: Annotated[Load, typer.Option(help="What else runs meanwhile: idle or stress.")] = Load.IDLE,
        chain: Annotated[bool, typer.Option(help="Measure calibrate --apply too; it builds two tables.")] = True,
        as_json: Annotated[bool, typer.Option("--json", help="Print JSON for machines.")] = False,
    ) -> None:
        """Fit, rebuild, verify and change over beside a run; then many changes of table under 1000 reports a second."""
        with tempfile.TemporaryDirectory(prefix="tactable-bench-") as name:
            result: dict[str, Any] = {
                "simulated": True,
                "machine": {"python": platform.python_version(), "cores": os.cpu_count(), "load": os.getloadavg()[0]},
                "chain": measure_chain(device_name, Path(name)) if chain else None,
                "changes": None,
            }
            if swaps:
                tables = make_tables(device_name, Path(name))
                result["changes"] = measure_changes(tables, swaps, load, Path(name))
        if as_json:
            print(json.dumps(result, indent=2))  # noqa: T201  # JSON goes out as it is, without a terminal's width
        else:
            print_recalibrate_bench(_out, result)


def measure_chain(device_name: str, folder: Path) -> dict[str, Any]:
    """Seconds from the start of `calibrate --apply` on drifted, SIMULATED measurements until a run has changed over."""
    from precompute.builder.build import build_table
    from precompute.parallel.cores import available_cores

    device, table, measured = find_device(device_name), folder / "chain.nc", folder / "measured.csv"
    build_table(device, table, clicks_up_to=0, workers=available_cores())
    changes = [word for change in _DRIFT for word in ("--change", change)]
    _run(folder, "simulate-measurements", str(find_device_file(device_name)), "-o", str(measured), *changes)
    with resting_run(table, folder) as run:
        start_s = time.perf_counter()
        words = ("calibrate", device_name, str(measured), "-o", str(folder / "fitted"), "--apply", str(table), "--json")
        applying = subprocess.Popen([*TACTABLE, *words], stdout=subprocess.PIPE)
        run.wait_for_change()
        playing_s = time.perf_counter() - start_s
        told, _ = applying.communicate()
    said = json.loads(told)["applied"]
    return {
        "playing_after_s": playing_s,
        "in_place_after_s": said["in_place_after_s"],
        "interpreter_and_the_rest_s": playing_s - sum(said["seconds"].values()),
        "seconds": said["seconds"],
        "entries_changed": said["diff"]["entries"]["changed"],
    }


def make_tables(device_name: str, folder: Path) -> tuple[Path, Path]:
    """Two tables of a device on a coarse grid, with all its states, that drive differently."""
    from engine.device import Device
    from precompute.builder.build import build_table
    from precompute.fleet.device_text import with_values
    from precompute.parallel.cores import available_cores

    coarse = {"sweep.step": "10 Hz", "sweep.amplitude_steps": "2", "sweep.phase_steps": "8"}
    text, paths = find_device(device_name).text, []
    for number, stiffness in enumerate(_STIFFNESS):
        path = folder / f"table-{number}.nc"
        values = {**coarse, "actuator[1].stiffness": stiffness}
        device = Device.parse(with_values(text, values, device_name), device_name)
        build_table(device, path, clicks_up_to=0, workers=available_cores())
        paths.append(path)
    return paths[0], paths[1]


def print_recalibrate_bench(out: Console, result: dict[str, Any]) -> None:
    """The chain by step, then what changes cost beside the same run without."""

    def say(text: str) -> None:
        out.print(text, markup=False, highlight=False, soft_wrap=True)

    machine = result["machine"]
    say(f"SIMULATED digitizer and firmware, {machine['cores']} cores, load {machine['load']:.1f} before")
    if chain := result["chain"]:
        say(f"from `calibrate --apply` until the run plays the new table: {chain['playing_after_s']:.1f} s")
        say(f"  {times_text(chain['seconds'])}; {chain['entries_changed']} entries changed")
    if changes := result["changes"]:
        grid = Grid("", "without changes", "with")
        for name, words in _ROWS.items():
            grid.add_row(words, *(_text(changes[which][name]) for which in ("without", "with")))
        out.print(grid)
        say(f"pause of {changes['with']['changes']} changes: {_quantiles(changes['pause_ms'])}")
        say(f"the same of as many instants without: {_quantiles(changes['no_pause_ms'])}")


def _text(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:.2f}"


def _quantiles(found: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:.2f} ms" for name, value in found.items())


def _run(folder: Path, *words: str) -> None:
    subprocess.run([*TACTABLE, *words], cwd=folder, check=True, stdout=subprocess.DEVNULL)
