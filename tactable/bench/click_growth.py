"""How time and memory of clicks grow with zones, with the plants they are optimised over, and with their length."""

import platform
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import matplotlib.figure
import numpy as np
from rich.console import Console
from rich.table import Table as Grid

from engine.device import Device, Zone
from engine.device.file import ROMAN
from precompute.clicks.options import DEFAULT_OPTIONS, ClickOptions
from precompute.clicks.solver import ClickSolver
from precompute.entries.prediction import touched_zones
from precompute.entries.solver import tabulated_states
from precompute.parallel.pool import solve_in_processes
from tactable.figures.file import Picture
from tactable.figures.style import BLUE, GREY, VERMILLION

ZONES, SCENARIOS, LENGTHS_MS = (2, 3, 4, 5, 6), (10, 20, 40, 80), (10, 20, 30, 40)
MOST_SOLVED = 15
"""Of more states, so many are solved, evenly chosen among those with the same fingers side by side."""
_LABELS = {"zones": "zones", "scenarios": "plants optimised over", "length_ms": "length in ms"}
Job = tuple[str, int]


def run_growth(
    device: Device,
    told: Callable[[float], None],
    *,
    zones: tuple[int, ...] = ZONES,
    scenarios: tuple[int, ...] = SCENARIOS,
    lengths_ms: tuple[int, ...] = LENGTHS_MS,
    options: ClickOptions = DEFAULT_OPTIONS,
) -> dict[str, Any]:
    """Processor time and memory of a process of its own for every number of zones, scenarios and milliseconds.

    One thing varies at a time, from the device and the options. `told` the fraction done.
    """
    jobs: list[Job] = [
        *[("zones", count) for count in zones],
        *[("scenarios", count) for count in scenarios],
        *[("length_ms", length_ms) for length_ms in lengths_ms],
    ]
    rows = list[dict[str, Any]]()
    for job in jobs:  # a process for each, since the memory of a process only grows
        rows += solve_in_processes(partial(_begin, device, options), [[job]], 1)
        told(len(rows) / len(jobs))
    return {
        "machine": f"{platform.machine()}, Python {platform.python_version()}",
        "device": device.name,
        "options": {"scenarios": options.scenarios, "trimmed": options.trimmed, "judged": options.judged},
        "rows": rows,
        "exponents": {varied: _exponent([row for row in rows if row["varied"] == varied]) for varied in _LABELS},
    }


def _begin(device: Device, options: ClickOptions) -> Callable[[Job], dict[str, Any]]:
    return partial(_measure, device, options)


def _measure(device: Device, options: ClickOptions, job: Job) -> dict[str, Any]:
    varied, value = job
    if varied == "zones":
        device = _with_zones(device, value)
    elif varied == "scenarios":
        options = replace(options, scenarios=value)
    else:
        options = replace(options, lengths_s=(value / 1e3,))
    states = sorted(tabulated_states(device), key=touched_zones)
    chosen = states[:: -(-len(states) // MOST_SOLVED)]
    begun_s = time.process_time()
    solver = ClickSolver(device, options)
    ready_s = time.process_time() - begun_s
    plants_s, solving_s = dict[tuple[int, ...], float](), list[float]()
    for state in chosen:
        start_s = time.process_time()
        solver.plants_of(touched_zones(state))
        middle_s = time.process_time()
        solver.solve(state)
        plants_s.setdefault(touched_zones(state), middle_s - start_s)
        solving_s.append(time.process_time() - middle_s)
    groups = len({touched_zones(state) for state in states})
    # States with the same fingers share their plants, which the chosen ones seldom do.
    all_s = ready_s + groups * float(np.mean(list(plants_s.values()))) + len(states) * float(np.mean(solving_s))
    return {
        "varied": varied,
        "value": value,
        "states": len(states),
        "solved": len(chosen),
        "all_states_s": all_s,
        "s_per_state": all_s / len(states),
        "memory_mib": _most_memory_mib(),
    }


def _with_zones(device: Device, count: int) -> Device:
    """The device with so many equal zones."""
    edges = np.linspace(0.0, device.bar.length_m, count + 1).tolist()
    return replace(device, zones=tuple(Zone(n, a, b) for n, (a, b) in zip(ROMAN, pairwise(edges), strict=False)))


def _most_memory_mib() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return used / (1 << 20 if sys.platform == "darwin" else 1 << 10)


def _exponent(rows: list[dict[str, Any]]) -> float | None:
    """Slope of log time over log of what varies: over the states, where the zones do."""
    if len(rows) < 2:
        return None
    x = np.log([row["states"] if row["varied"] == "zones" else row["value"] for row in rows])
    return float(np.polyfit(x, np.log([row["all_states_s"] for row in rows]), 1)[0])


def print_growth(out: Console, result: dict[str, Any]) -> None:
    """One table: what varies, seconds, memory; then the exponents."""
    grid = Grid("varied", "value", "states", "CPU s for all", "CPU s a state", "peak MiB", title=result["device"])
    for row in result["rows"]:
        mark = "" if row["solved"] == row["states"] else f" (from {row['solved']})"
        grid.add_row(
            _LABELS[row["varied"]],
            str(row["value"]),
            str(row["states"]),
            f"{row['all_states_s']:.1f}{mark}",
            f"{row['s_per_state']:.2f}",
            f"{row['memory_mib']:.0f}",
        )
    out.print(grid)
    for varied, exponent in result["exponents"].items():
        if exponent is not None:
            over = "states" if varied == "zones" else _LABELS[varied]
            out.print(f"time for all states grows as ({over})^{exponent:.2f}", highlight=False)
    out.print(f"{result['machine']}; one process, BLAS with one thread", highlight=False)


def draw_growth(result: dict[str, Any]) -> Picture:
    """Processor seconds for all states, and memory, over each of what varies."""
    figure = matplotlib.figure.Figure(figsize=(9, 3.2), layout="constrained")
    columns: dict[str, list[Any]] = {key: [] for key in ("varied", "value", "states", "all_states_s", "memory_mib")}
    for axes, (varied, label) in zip(figure.subplots(1, len(_LABELS)), _LABELS.items(), strict=True):
        rows = [row for row in result["rows"] if row["varied"] == varied]
        value = [row["value"] for row in rows]
        axes.semilogy(value, [row["all_states_s"] for row in rows], "o-", color=BLUE)
        axes.set_xlabel(label)
        axes.set_ylabel("processor s for all states", color=BLUE)
        axes.grid(visible=True, which="both", color=GREY, alpha=0.3)
        memory = axes.twinx()
        memory.plot(value, [row["memory_mib"] for row in rows], "s--", color=VERMILLION)
        memory.set_ylabel("memory in MiB", color=VERMILLION)
        memory.set_ylim(bottom=0)
        for key, column in columns.items():
            column += [row[key] for row in rows]
    options = result["options"]
    caption = (
        f"{result['device']}: clicks optimised over {options['scenarios']} plants, trimmed on {options['trimmed']}; "
        f"{result['machine']}"
    )
    figure.suptitle(caption, fontsize="small")
    return Picture(figure, columns, {"exponents": result["exponents"]}, caption)
