"""Processor time and memory of entries and clicks as the number of zones, actuators, sampled plants or length grows.

`python -m tests.studies.cost.growth entries|clicks [--device NAME] [--figure FILE] [--json]` shows that the time grows
about in proportion to the number of states, and that memory stays bounded. Where a case has many states only some of
them are solved, evenly chosen with those that share their fingers side by side, and the time for all is extrapolated.
"""

import argparse
import json
import platform
import resource
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib.figure
import numpy as np
from threadpoolctl import threadpool_limits

from engine.device import Device, Zone
from engine.device.file import ROMAN
from engine.touch import Placement
from precompute.clicks import DEFAULT_OPTIONS, ClickOptions, ClickSolver
from precompute.entries.prediction import States, touched_zones
from precompute.entries.solver import tabulated_states
from precompute.parallel.pool import solve_in_processes
from tactable.bench.entries import STEP_HZ, time_entries
from tactable.shipped import find_device

ENTRY_ZONES, ENTRY_ACTUATORS, MOST_ENTRY_STATES = (3, 4, 5, 6, 7, 8), (2, 3, 4), 65
CLICK_CASES = (
    *[("zones", count) for count in (2, 3, 4, 5, 6)],
    *[("scenarios", count) for count in (10, 20, 40, 80)],
    *[("length_ms", length_ms) for length_ms in (10, 20, 30, 40)],
)
MOST_CLICK_STATES = 15
Case = tuple[str, int]


def measure_entries(device: Device, zones: Sequence[int], actuators: Sequence[int]) -> list[dict[str, Any]]:
    """One row for each number of actuators and of zones: states, seconds for all of them, memory."""
    rows = []
    with threadpool_limits(1, "blas"):
        for count in actuators:
            for zone_count in zones:
                varied = _with_actuators(_with_zones(device, zone_count), count)
                row = time_entries(varied, _chosen(varied, MOST_ENTRY_STATES))
                rows.append({"series": f"{count} actuators", "value": zone_count, **row})
    return rows


def measure_clicks(device: Device, options: ClickOptions, cases: Sequence[Case]) -> list[dict[str, Any]]:
    """One row for each case, which varies one thing from the device and the options.

    Every case has a process of its own, since the memory of a process only grows.
    """
    rows = list[dict[str, Any]]()
    for case in cases:
        rows += solve_in_processes(partial(_begin, device, options), [[case]], 1)
    return rows


def _begin(device: Device, options: ClickOptions) -> Callable[[Case], dict[str, Any]]:
    return partial(_time_clicks, device, options)


def _time_clicks(device: Device, options: ClickOptions, case: Case) -> dict[str, Any]:
    varied, value = case
    if varied == "zones":
        device = _with_zones(device, value)
    elif varied == "scenarios":
        options = replace(options, scenarios=value)
    else:
        options = replace(options, lengths_s=(value / 1e3,))
    states, chosen = tabulated_states(device), _chosen(device, MOST_CLICK_STATES)
    begun_s = time.process_time()
    solver = ClickSolver(device, options)
    ready_s = time.process_time() - begun_s
    plants_s, solving_s = dict[tuple[int, ...], float](), list[float]()
    for state in chosen:
        start_s = time.process_time()
        placement = Placement.in_zones(device, state)
        solver.plants_of(placement.position_m)
        middle_s = time.process_time()
        solver.solve(placement)
        plants_s.setdefault(touched_zones(state), middle_s - start_s)
        solving_s.append(time.process_time() - middle_s)
    # States with the same fingers share their plants, which the few chosen ones seldom do.
    groups = len({touched_zones(state) for state in states})
    all_s = ready_s + groups * float(np.mean(list(plants_s.values()))) + len(states) * float(np.mean(solving_s))
    return {
        "series": varied,
        "value": value,
        "states": len(states),
        "solved": len(chosen),
        "all_states_s": all_s,
        "memory_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def _chosen(device: Device, most: int) -> list[States]:
    states = sorted(tabulated_states(device), key=touched_zones)
    return states[:: -(-len(states) // most)]


def _with_zones(device: Device, count: int) -> Device:
    """The device with `count` equal zones."""
    edges = np.linspace(0.0, device.bar.length_m, count + 1).tolist()
    return replace(device, zones=tuple(Zone(n, a, b) for n, (a, b) in zip(ROMAN, pairwise(edges), strict=False)))


def _with_actuators(device: Device, count: int) -> Device:
    """The device with `count` actuators: copies of the first one evenly between the outer two."""
    first, last = device.actuators[0], device.actuators[-1]
    places_m = np.linspace(first.position_m, last.position_m, count).tolist()
    actuators = [
        replace(last if i == count - 1 else first, name=f"actuator {i}", position_m=place_m)
        for i, place_m in enumerate(places_m)
    ]
    return replace(device, actuators=tuple(actuators))


def exponents_of(rows: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Slope of log time over log of what varies, by series: over the number of states where that differs."""
    found = {}
    for series in dict.fromkeys(row["series"] for row in rows):
        own = [row for row in rows if row["series"] == series]
        key = "states" if len({row["states"] for row in own}) > 1 else "value"
        if len(own) > 1:
            x, y = (np.log([row[name] for row in own]) for name in (key, "all_states_s"))
            found[series] = float(np.polyfit(x, y, 1)[0])
    return found


def draw(rows: Sequence[dict[str, Any]], title: str, path: Path) -> None:
    """Seconds for all states and memory, a panel for each series."""
    names = list(dict.fromkeys(row["series"] for row in rows))
    figure = matplotlib.figure.Figure(figsize=(3 * len(names), 3.2), layout="constrained")
    for axes, name in zip(np.atleast_1d(figure.subplots(1, len(names))), names, strict=True):
        own = [row for row in rows if row["series"] == name]
        value = [row["value"] for row in own]
        axes.semilogy(value, [row["all_states_s"] for row in own], "o-", color="C0")
        axes.set_xlabel(f"zones ({name})" if name.endswith("actuators") else name)
        axes.set_ylabel("seconds for all states", color="C0")
        memory = axes.twinx()
        memory.plot(value, [row["memory_mib"] for row in own], "s--", color="C1")
        memory.set_ylabel("memory in MiB", color="C1")
        memory.set_ylim(bottom=0)
    figure.suptitle(title, fontsize="small")
    figure.savefig(path, dpi=150)


def main() -> None:
    """Print a row for each case, then the exponents."""
    parser = argparse.ArgumentParser(prog="tests.studies.cost.growth", description=__doc__)
    parser.add_argument("what", choices=("entries", "clicks"))
    parser.add_argument("--device", default="reference-a")
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    device = find_device(asked.device)
    if asked.what == "entries":
        coarse = replace(device, sweep=replace(device.sweep, step_hz=STEP_HZ))
        rows = measure_entries(coarse, ENTRY_ZONES, ENTRY_ACTUATORS)
    else:
        rows = measure_clicks(device, DEFAULT_OPTIONS, CLICK_CASES)
    machine = f"{device.name}, {asked.what}; {platform.machine()}, Python {platform.python_version()}"
    if asked.figure is not None:
        draw(rows, machine, asked.figure)
    if asked.json:
        print(json.dumps({"machine": machine, "rows": rows, "exponents": exponents_of(rows)}, indent=2))
        return
    print(machine)
    for row in rows:
        solved = "" if row["solved"] == row["states"] else f" (from {row['solved']})"
        print(
            f"{row['series']:>12} {row['value']:4d}: {row['states']:5d} states {row['all_states_s']:8.1f} s{solved}, "
            f"{row['memory_mib']:.0f} MiB"
        )
    for series, exponent in exponents_of(rows).items():
        print(f"{series}: time grows with exponent {exponent:.2f}")


if __name__ == "__main__":
    main()
