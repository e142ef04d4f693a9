"""How long the entries of a device take, and how that grows with zones and actuators, beside a generic solver."""

import os
import platform
import resource
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib.figure
import numpy as np
import scipy.optimize
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table as Grid
from threadpoolctl import threadpool_limits

from engine.device import Device, Zone
from engine.device.file import ROMAN
from engine.touch import ZoneState
from precompute.entries.candidate import powers_of
from precompute.entries.objective import DEFAULT_OBJECTIVE, OBJECTIVES, Problem
from precompute.entries.prediction import touched_zones
from precompute.entries.solver import EntrySolver, tabulated_states
from precompute.model.assembly import assemble

Array = NDArray[np.float64]

STEP_HZ = 0.5
_MOST_SOLVED = 65
"""Of more states, so many are solved for the growth, evenly chosen; the time for all is extrapolated and marked."""
_SLSQP_STARTS = 20
_SLSQP_STATES = 3


def run_states_bench(device: Device, zones: list[int], actuators: list[int]) -> dict[str, Any]:
    """Time and memory for every count of zones and actuators, with the exponent of the growth in states."""
    with threadpool_limits(1, "blas"):
        base = _varied(device, len(device.zones), len(device.actuators))
        own = _time_states(base, len(tabulated_states(base)))
        rival_s = _time_slsqp(base)
        rows = [_time_states(_varied(device, n, m), _MOST_SOLVED) for m in actuators for n in zones]
    fits = {m: _exponent([row for row in rows if row["actuators"] == m]) for m in actuators}
    return {
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}",
        "step_hz": STEP_HZ,
        "levels": len(device.levels_db) + 1,
        "device": own,
        "slsqp_s_per_entry": rival_s,
        "slsqp_ratio": rival_s / own["s_per_entry"],
        "rows": rows,
        "exponent_of_states": {str(m): exponent for m, exponent in fits.items()},
    }


def _varied(device: Device, zones: int, actuators: int) -> Device:
    """The device with equal zones, and its actuators with copies of the first evenly between the outer ones."""
    sweep = replace(device.sweep, step_hz=STEP_HZ)
    if (zones, actuators) == (len(device.zones), len(device.actuators)):
        return replace(device, sweep=sweep)
    edges = np.linspace(0.0, device.bar.length_m, zones + 1).tolist()
    first, last = device.actuators[0], device.actuators[-1]
    places = np.linspace(first.position_m, last.position_m, actuators).tolist()
    own = [
        replace(last if place == places[-1] else first, name=f"actuator {i}", position_m=place)
        for i, place in enumerate(places)
    ]
    named = tuple(Zone(name, a, b) for name, (a, b) in zip(ROMAN, pairwise(edges), strict=False))
    return replace(device, sweep=sweep, zones=named, actuators=tuple(own))


def _time_states(device: Device, most: int) -> dict[str, Any]:
    solver = EntrySolver(assemble(device))
    solver.solve(tabulated_states(device)[0])  # kernels compiled, caches of the machine filled
    states = sorted(tabulated_states(device), key=touched_zones)
    chosen = states[:: -(-len(states) // most)]
    start_s = time.perf_counter()
    solver = EntrySolver(assemble(device))
    gaps_db = [entry.optimality_gap_db for state in chosen for entry in solver.solve(state)]
    spent_s = time.perf_counter() - start_s
    return {
        "zones": len(device.zones),
        "actuators": len(device.actuators),
        "states": len(states),
        "solved": len(chosen),
        "all_states_s": spent_s * len(states) / len(chosen),
        "s_per_entry": spent_s / len(gaps_db),
        "median_gap_db": float(np.median(gaps_db)),
        "memory_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def _exponent(rows: list[dict[str, Any]]) -> float | None:
    """Slope of log time over log states."""
    if len(rows) < 2:
        return None
    x, y = (np.log([row[key] for row in rows]) for key in ("states", "all_states_s"))
    return float(np.polyfit(x, y, 1)[0])


def _time_slsqp(device: Device) -> float:
    """Seconds for one entry by SLSQP from random starts, frequency, amplitudes and phases free, on the same forms."""
    solver = EntrySolver(assemble(device))
    random, spent_s = np.random.default_rng(0), 0.0
    states = [state for state in tabulated_states(device) if ZoneState.QUIET in state]
    for state in states[:: max(1, len(states) // _SLSQP_STATES)][:_SLSQP_STATES]:
        problem = OBJECTIVES[DEFAULT_OBJECTIVE](solver.forms_of(touched_zones(state)), state)
        wanted = solver.wanted_power(device.levels_db[0])
        start_s = time.perf_counter()
        for _ in range(_SLSQP_STARTS):
            _slsqp(problem, wanted, random)
        spent_s += time.perf_counter() - start_s
    return spent_s / _SLSQP_STATES


def _slsqp(problem: Problem, wanted: float, random: np.random.Generator) -> None:
    count, hz = problem.in_band.shape[1], problem.frequency_hz
    tone = np.zeros(count, dtype=np.int64)

    def powers(x: Array) -> list[Array]:
        amplitude = x[1 : count + 1] * np.exp(1j * x[count + 1 :])
        at_hz = np.array([np.clip(x[0] * 100, hz[0], hz[-1])])
        return [powers_of(stack, hz, at_hz, tone, amplitude) for stack in problem.stacks]

    def loss(x: Array) -> float:
        numerator, denominator, _ = powers(x)
        return float(10 * np.log10(max(denominator.max(), 1e-30) / max(numerator.min(), 1e-30)))

    def spare(x: Array) -> Array:
        db: Array = 10 * np.log10(np.maximum(powers(x)[2], 1e-30) / wanted)
        return db

    start = np.concatenate(
        [[random.uniform(hz[0], hz[-1]) / 100], random.uniform(0.1, 1, count), random.uniform(-3, 3, count)]
    )
    bounds = [(hz[0] / 100, hz[-1] / 100), *[(0.0, 1.0)] * count, *[(-7.0, 7.0)] * count]
    constraint = scipy.optimize.NonlinearConstraint(spare, 0.0, np.inf)
    scipy.optimize.minimize(loss, start, method="SLSQP", bounds=bounds, constraints=[constraint])


def print_states_bench(out: Console, result: dict[str, Any]) -> None:
    """One table: counts, seconds, memory; then the exponents and the rival."""
    grid = Grid("zones", "actuators", "states", "s for all", "ms an entry", "median gap dB", "peak MiB")
    for row in result["rows"]:
        mark = "" if row["solved"] == row["states"] else f" (from {row['solved']})"
        grid.add_row(
            str(row["zones"]),
            str(row["actuators"]),
            str(row["states"]),
            f"{row['all_states_s']:.1f}{mark}",
            f"{1e3 * row['s_per_entry']:.1f}",
            f"{row['median_gap_db']:.3f}",
            f"{row['memory_mib']:.0f}",
        )
    own = result["device"]
    out.print(f"{result['machine']}; {result['levels']} levels, {result['step_hz']} Hz", highlight=False)
    out.print(
        f"the device itself: {own['states']} states in {own['all_states_s']:.1f} s; SLSQP from {_SLSQP_STARTS} starts "
        f"takes {result['slsqp_ratio']:.0f} times as long for an entry",
        highlight=False,
    )
    if result["rows"]:
        out.print(grid)
    for actuators, exponent in result["exponent_of_states"].items():
        if exponent is not None:
            out.print(f"{actuators} actuators: time grows as states^{exponent:.2f}", highlight=False)


def draw_states_bench(result: dict[str, Any], path: Path) -> None:
    """Seconds over states, one line for each number of actuators."""
    figure = matplotlib.figure.Figure(figsize=(6, 4), layout="constrained")
    axes = figure.subplots()
    markers = "osD^v"
    for i, (actuators, exponent) in enumerate(result["exponent_of_states"].items()):
        rows = [row for row in result["rows"] if row["actuators"] == int(actuators)]
        label = f"{actuators} actuators" + ("" if exponent is None else f", states^{exponent:.2f}")
        x, y = ([row[key] for row in rows] for key in ("states", "all_states_s"))
        axes.loglog(x, y, marker=markers[i % len(markers)], label=label)
    axes.set_xlabel("states with a felt zone")
    axes.set_ylabel(f"seconds for all, {result['levels']} levels each")
    axes.set_title(result["machine"], fontsize=9)
    axes.grid(visible=True, which="both", alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=150)
