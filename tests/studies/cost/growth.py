"""Processor time and memory of clicks as fingers, actuators, sampled plants or the length grow.

`python -m tests.studies.cost.growth [--figure FILE]` shows how the time of one click grows with
each of them alone, and that memory stays bounded. Clicks are those of random placements; a table takes as many times
longer as it has placements.
"""

import platform
import resource
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import matplotlib.figure
import numpy as np

from engine.device import Device, Zone
from precompute.clicks import DEFAULT_OPTIONS, ClickOptions, ClickSolver
from precompute.sampling.placements import Anywhere, random_placements
from tactable.shipped import find_device
from tests.precompute.parallel.solving import solve_in_processes
from tests.studies.options import read_options

CLICK_CASES = (
    *[("fingers", count) for count in (1, 2, 3, 5, 8)],
    *[("actuators", count) for count in (2, 3, 4, 8)],
    *[("plants", count) for count in (80, 120, 240, 480)],
    *[("ms of click", length_ms) for length_ms in (10, 20, 30, 40)],
    *[("mm of bar", length_mm) for length_mm in (150, 300, 600)],
)
CLICKS = 12
APART_M = 15e-3
"""Fingers of a placement are at least this far apart."""
Case = tuple[str, int]
Result = TypeVar("Result")


def measure_clicks(device: Device, options: ClickOptions, cases: Sequence[Case], clicks: int) -> list[dict[str, Any]]:
    """One row for each case, which varies one thing from the device, the options and two fingers: seconds of a click.

    Every case has a process of its own, since the memory of a process only grows.
    """
    begin = partial(partial, time_clicks, device, options, clicks)
    return [row for case in cases for row in solve_in_processes(begin, [[case]], 1)]


def time_clicks(device: Device, options: ClickOptions, clicks: int, case: Case) -> dict[str, Any]:
    """The row of one case, measured in this process."""
    varied, value = case
    wanted = Anywhere(clicks + 1, apart_m=APART_M)
    if varied == "fingers":
        wanted = replace(wanted, fingers=value)
    elif varied == "actuators":
        device = _with_actuators(device, value)
    elif varied == "plants":
        options = replace(options, pool=value)
    elif varied == "ms of click":
        options = replace(options, length_s=value / 1e3)
    else:
        device = _with_length(device, value / 1e3)
    solver, first_s = timed(partial(ClickSolver, device, options))
    warm_up, *placements = random_placements(device, wanted)
    solver.solve(warm_up)  # kernels and libraries are loaded
    times_s = [timed(partial(solver.solve, placement))[1] for placement in placements]
    return {
        "series": varied,
        "value": value,
        "click_s": float(np.mean(times_s)),
        "device_s": first_s,
        "memory_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def timed(call: Callable[[], Result]) -> tuple[Result, float]:
    """What `call` gives, and its seconds of processor time."""
    start_s = time.process_time()
    result = call()
    return result, time.process_time() - start_s


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
        surface=replace(device.bar, length_m=length_m),
        actuators=tuple(replace(each, position_m=scale * each.position_m) for each in device.actuators),
        zones=tuple(Zone(zone.name, scale * zone.start_m, scale * zone.stop_m) for zone in device.zones),
    )


def exponents_of(rows: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Slope of log time over log of what varies, by series."""
    found = {}
    for series in dict.fromkeys(row["series"] for row in rows):
        own = [row for row in rows if row["series"] == series]
        if len(own) > 1:
            x, y = (np.log([row[name] for row in own]) for name in ("value", "click_s"))
            found[series] = float(np.polyfit(x, y, 1)[0])
    return found


def draw(rows: Sequence[dict[str, Any]], title: str, path: Path | str) -> None:
    """Seconds for one click, and memory, a panel for each series."""
    names = list(dict.fromkeys(row["series"] for row in rows))
    figure = matplotlib.figure.Figure(figsize=(3 * len(names), 3.2), layout="constrained")
    for axes, name in zip(np.atleast_1d(figure.subplots(1, len(names))), names, strict=True):
        own = [row for row in rows if row["series"] == name]
        value = [row["value"] for row in own]
        axes.plot(value, [row["click_s"] for row in own], "o-", color="C0")
        axes.set_ylim(bottom=0)
        axes.set_xlabel(name)
        axes.set_ylabel("seconds of a click", color="C0")
        memory = axes.twinx()
        memory.plot(value, [row["memory_mib"] for row in own], "s--", color="C1")
        memory.set_ylabel("memory in MiB", color="C1")
        memory.set_ylim(bottom=0)
    figure.suptitle(title, fontsize="small")
    figure.savefig(path, dpi=150)


def main() -> None:
    """Print a row for each case, then the exponents."""
    asked = read_options(__doc__, figure="")
    device = find_device("reference-a")
    machine = f"{device.name}, clicks; {platform.machine()}, Python {platform.python_version()}"
    rows = measure_clicks(device, DEFAULT_OPTIONS, CLICK_CASES, CLICKS)
    if asked.figure:
        draw(rows, machine, asked.figure)
    print(machine)
    for row in rows:
        print(f"{row['series']:>12} {row['value']:4d}: a click {row['click_s']:8.3f} s, {row['memory_mib']:.0f} MiB")
    for series, exponent in exponents_of(rows).items():
        print(f"{series}: time grows with exponent {exponent:.2f}")


if __name__ == "__main__":
    main()
