"""Processor time and memory of entries and clicks as zones, fingers, actuators, sampled plants or the length grow.

`python -m tests.studies.cost.growth entries|clicks [--device NAME] [--figure FILE]` shows how the time of all
states, or of one click, grows with each of them alone, and that memory stays bounded. Where a case has many states only
some of them are solved, evenly chosen, and the time for all is extrapolated. Clicks are those of random placements; a
table takes as many times longer as it has placements.

`growth workers` shares the clicks of a grid of placements of a bar with eight actuators among one and two Dask workers.
"""

import argparse
import json
import platform
import resource
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib.figure
import numpy as np
from threadpoolctl import threadpool_limits

from engine.device import Device, Zone
from precompute.clicks import DEFAULT_OPTIONS, ClickOptions, ClickSolver
from precompute.entries.prediction import States, touched_zones
from precompute.entries.solver import tabulated_states
from precompute.parallel.pool import solve_in_processes
from precompute.studies.anywhere import Anywhere, random_placements
from tactable.bench.entries import STEP_HZ, time_entries
from tactable.shipped import find_device
from tests.precompute.devices import with_zones
from tests.studies.cost.click_workers import APART_M, grid_of, measure_workers, timed

ENTRY_ZONES, ENTRY_ACTUATORS, MOST_ENTRY_STATES = (3, 4, 5, 6, 7, 8), (2, 3, 4), 65
CLICK_CASES = (
    *[("fingers", count) for count in (1, 2, 3, 5, 8)],
    *[("actuators", count) for count in (2, 3, 4, 8)],
    *[("plants", count) for count in (10, 20, 40, 80)],
    *[("ms of click", length_ms) for length_ms in (10, 20, 30, 40)],
    *[("mm of bar", length_mm) for length_mm in (150, 300, 600)],
)
CLICKS = 12
WORKER_ACTUATORS, WORKER_PLACEMENTS, SOLVED_PLACEMENTS = 8, 2000, 60
Case = tuple[str, int]


def measure_entries(device: Device, zones: Sequence[int], actuators: Sequence[int]) -> list[dict[str, Any]]:
    """One row for each number of actuators and of zones: states, seconds for all of them, memory."""
    rows = []
    with threadpool_limits(1, "blas"):
        for count in actuators:
            for zone_count in zones:
                varied = _with_actuators(with_zones(device, zone_count), count)
                row = time_entries(varied, _chosen(varied, MOST_ENTRY_STATES))
                rows.append({"series": f"{count} actuators", "value": zone_count, **row})
    return rows


def measure_clicks(device: Device, options: ClickOptions, cases: Sequence[Case], clicks: int) -> list[dict[str, Any]]:
    """One row for each case, which varies one thing from the device, the options and two fingers: seconds of a click.

    Every case has a process of its own, since the memory of a process only grows.
    """
    rows = list[dict[str, Any]]()
    for case in cases:
        rows += solve_in_processes(partial(_begin, device, options, clicks), [[case]], 1)
    return rows


def _begin(device: Device, options: ClickOptions, clicks: int) -> Callable[[Case], dict[str, Any]]:
    return partial(time_clicks, device, options, clicks)


def time_clicks(device: Device, options: ClickOptions, clicks: int, case: Case) -> dict[str, Any]:
    """The row of one case, measured in this process."""
    varied, value = case
    wanted = Anywhere(clicks + 1, apart_m=APART_M)
    if varied == "fingers":
        wanted = replace(wanted, fingers=value)
    elif varied == "actuators":
        device = _with_actuators(device, value)
    elif varied == "plants":
        options = replace(options, scenarios=value)
    elif varied == "ms of click":
        options = replace(options, lengths_s=(value / 1e3,))
    else:
        device = _with_length(device, value / 1e3)
    solver, first_s = timed(partial(ClickSolver, device, options))
    warm_up, *placements = random_placements(device, wanted)
    solver.solve(warm_up)  # kernels and libraries are loaded
    times_s = [timed(partial(solver.solve, placement))[1] for placement in placements]
    return {
        "series": varied,
        "value": value,
        "states": clicks,
        "solved": clicks,
        "click_s": float(np.mean(times_s)),
        "device_s": first_s,
        "memory_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def _chosen(device: Device, most: int) -> list[States]:
    states = sorted(tabulated_states(device), key=touched_zones)
    return states[:: -(-len(states) // most)]


def _with_actuators(device: Device, count: int) -> Device:
    """The device with `count` actuators: copies of the first one evenly between the outer two."""
    first, last = device.actuators[0], device.actuators[-1]
    places_m = np.linspace(first.position_m, last.position_m, count).tolist()
    actuators = [
        replace(last if i == count - 1 else first, name=f"actuator {i}", position_m=place_m)
        for i, place_m in enumerate(places_m)
    ]
    return replace(device, actuators=tuple(actuators))


def _with_length(device: Device, length_m: float) -> Device:
    """The device on a bar of another length, with actuators and zones in the same proportions."""
    scale = length_m / device.bar.length_m
    return replace(
        device,
        bar=replace(device.bar, length_m=length_m),
        actuators=tuple(replace(each, position_m=scale * each.position_m) for each in device.actuators),
        zones=tuple(Zone(zone.name, scale * zone.start_m, scale * zone.stop_m) for zone in device.zones),
    )


def exponents_of(rows: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Slope of log time over log of what varies, by series: over the number of states where that differs."""
    found = {}
    for series in dict.fromkeys(row["series"] for row in rows):
        own = [row for row in rows if row["series"] == series]
        key = "states" if len({row["states"] for row in own}) > 1 else "value"
        if len(own) > 1:
            x, y = (np.log([row[name] for row in own]) for name in (key, _seconds_key(own[0])))
            found[series] = float(np.polyfit(x, y, 1)[0])
    return found


def _seconds_key(row: dict[str, Any]) -> str:
    return "click_s" if "click_s" in row else "all_states_s"


def draw(rows: Sequence[dict[str, Any]], title: str, path: Path) -> None:
    """Seconds for all states, or for one click, and memory, a panel for each series."""
    key = _seconds_key(rows[0])
    label = "seconds of a click" if key == "click_s" else "seconds for all states"
    names = list(dict.fromkeys(row["series"] for row in rows))
    figure = matplotlib.figure.Figure(figsize=(3 * len(names), 3.2), layout="constrained")
    for axes, name in zip(np.atleast_1d(figure.subplots(1, len(names))), names, strict=True):
        own = [row for row in rows if row["series"] == name]
        value = [row["value"] for row in own]
        axes.plot(value, [row[key] for row in own], "o-", color="C0")
        if key == "all_states_s":
            axes.set_yscale("log")
        else:
            axes.set_ylim(bottom=0)
        axes.set_xlabel(f"zones ({name})" if key == "all_states_s" else name)
        axes.set_ylabel(label, color="C0")
        memory = axes.twinx()
        memory.plot(value, [row["memory_mib"] for row in own], "s--", color="C1")
        memory.set_ylabel("memory in MiB", color="C1")
        memory.set_ylim(bottom=0)
    figure.suptitle(title, fontsize="small")
    figure.savefig(path, dpi=150)


def main() -> None:
    """Print a row for each case, then the exponents."""
    parser = argparse.ArgumentParser(prog="tests.studies.cost.growth", description=__doc__)
    parser.add_argument("what", choices=("entries", "clicks", "workers"))
    parser.add_argument("--device", default="reference-a")
    parser.add_argument("--solved", type=int, default=SOLVED_PLACEMENTS, help="placements that the workers solve")
    parser.add_argument("--figure", type=Path)
    asked = parser.parse_args()
    device = find_device(asked.device)
    machine = f"{device.name}, {asked.what}; {platform.machine()}, Python {platform.python_version()}"
    if asked.what == "workers":
        grid = grid_of(_with_actuators(device, WORKER_ACTUATORS), WORKER_PLACEMENTS)
        chosen = [grid[i] for i in np.linspace(0, len(grid) - 1, asked.solved + 1).round().astype(int)]
        rows = measure_workers(_with_actuators(device, WORKER_ACTUATORS), DEFAULT_OPTIONS, chosen, (1, 2))
        print(json.dumps({"machine": machine, "grid": len(grid), "rows": rows}, indent=2))
        return
    if asked.what == "entries":
        coarse = replace(device, sweep=replace(device.sweep, step_hz=STEP_HZ))
        rows = measure_entries(coarse, ENTRY_ZONES, ENTRY_ACTUATORS)
    else:
        rows = measure_clicks(device, DEFAULT_OPTIONS, CLICK_CASES, CLICKS)
    if asked.figure is not None:
        draw(rows, machine, asked.figure)
    print(machine)
    for row in rows:
        solved = "" if row["solved"] == row["states"] else f" (from {row['solved']})"
        what = f"{row['states']:5d} states" if asked.what == "entries" else "a click"
        print(
            f"{row['series']:>12} {row['value']:4d}: {what} {row[_seconds_key(row)]:8.3f} s{solved}, "
            f"{row['memory_mib']:.0f} MiB"
        )
    for series, exponent in exponents_of(rows).items():
        print(f"{series}: time grows with exponent {exponent:.2f}")


if __name__ == "__main__":
    main()
