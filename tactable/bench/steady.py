"""Steady drives at positions: time of a solve, beside the tabulated search on the same states, and what either reaches.

Processor time of one thread. Both sides take their turns state by state, so that a busy machine slows both alike.
"""

import os
import platform
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from threadpoolctl import threadpool_limits

from engine.device import Device
from engine.steady import SteadyDrive
from engine.steady.solver import SteadySolver
from engine.table import Entry
from engine.touch import ZoneState
from engine.touch.placement import MOST_FINGERS
from precompute.entries.prediction import objective_value, touched_zones
from precompute.entries.solver import EntrySolver, tabulated_states
from precompute.model.assembly import assemble
from precompute.predict.at_positions import SteadyDesigner, cases_in_zones
from precompute.sampling.places import solve_place_receptances

Array = NDArray[np.float64]

_FINGERS = (1, 2, 3, 5, MOST_FINGERS)
_LEVEL_DB = 20.0
_APART_M = 0.015
_KNOWN_DB = 0.03
"""A tabulated drive this near to its bound is the optimum."""


def run_steady_bench(device: Device, states: int, placements: int, seed: int) -> dict[str, Any]:
    """Compare `states` random states with the tabulated search, then time random placements of one to ten fingers."""
    random = np.random.default_rng(seed)
    with threadpool_limits(1, "blas"):
        solver = SteadyDesigner(device).solver
        times = {str(count): _time_placements(solver, count, placements, random) for count in _FINGERS}
        compared = _compare(device, states, random)
    return {
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}",
        "device": device.name,
        "actuators": len(device.actuators),
        "frequencies": len(solver.frequency_hz),
        "places": round(solver.device.bar.length_m / solver.pitch_m) + 1,
        "level_db": _LEVEL_DB,
        "solve_ms": times,
        "tabulated": compared,
    }


def _time_placements(
    solver: SteadySolver, fingers: int, placements: int, random: np.random.Generator
) -> dict[str, Any]:
    """Milliseconds of a solve: the first finger felt, the others quiet, at random positions _APART_M apart."""
    spare_m = solver.device.bar.length_m - (fingers - 1) * _APART_M
    spent_ms = []
    for _ in range(placements + 1):
        positions_m = np.sort(random.uniform(0.0, spare_m, fingers)) + _APART_M * np.arange(fingers)
        positions_m = random.permutation(positions_m)
        start_s = time.process_time()
        solver.solve(positions_m.tolist(), [True] + [False] * (fingers - 1), _LEVEL_DB)
        spent_ms.append(1e3 * (time.process_time() - start_s))
    # The first one loads the kernels.
    return {"median": float(np.median(spent_ms[1:])), "p95": float(np.percentile(spent_ms[1:], 95))}


def _compare(device: Device, count: int, random: np.random.Generator) -> dict[str, Any]:
    """Both on random states of the zones and the same sampled fingers, every level of the device."""
    search = EntrySolver(assemble(device))
    solver = SteadySolver(device, solve_place_receptances(search.plant, search.frequency_hz))
    states = tabulated_states(device)
    spent_s, rows = np.zeros(2), list[tuple[float, bool, bool]]()
    search.solve(states[0])  # compiles the kernels and fills the machine's caches
    for number in random.choice(len(states), min(count, len(states)), replace=False):
        state, zones = states[number], touched_zones(states[number])
        felt, cases = tuple(state[zone] is ZoneState.FELT for zone in zones), cases_in_zones(search.sampled, zones)
        solver.solve_cases(cases, felt, _LEVEL_DB)
        start_s = time.process_time()
        entries = search.solve(state)
        middle_s = time.process_time()
        drives = [solver.solve_cases(cases, felt, entry.wanted_level_db) for entry in entries]
        spent_s += np.diff([start_s, middle_s, time.process_time()])
        rows += [_row(entry, drive) for entry, drive in zip(entries, drives, strict=True)]
    lacking = {
        "known_optimum_of_one_tone": [d for d, one, known in rows if one and known and np.isfinite(d)],
        "one_tone": [d for d, one, _ in rows if one and np.isfinite(d)],
        "several_tones": [d for d, one, _ in rows if not one and np.isfinite(d)],
    }
    return {
        "entries": len(rows),
        "sampled_cases": len(search.sampled.place) - 1,
        "unreached": int(sum(d == -np.inf for d, _, _ in rows)),
        "ratio": float(spent_s[0] / spent_s[1]),
        "ms_per_entry": (1e3 * spent_s / max(len(rows), 1)).tolist(),
        "difference_db": {
            name: {
                "entries": len(each),
                "worst": float(min(each, default=0.0)),
                "median": float(np.median(each or [0.0])),
            }
            for name, each in lacking.items()
        },
    }


def _row(entry: Entry, drive: SteadyDrive) -> tuple[float, bool, bool]:
    """By how many dB the drive is better, whether the entry plays one tone, and whether it is a known optimum.

    -inf: the entry reaches a level that the drive does not.
    """
    value = objective_value(entry)
    assert value is not None  # the default objective claims one
    is_one_tone, is_known = entry.family in ("coherent", "single tone"), entry.optimality_gap_db <= _KNOWN_DB
    if drive.objective != entry.objective:
        return -np.inf, is_one_tone, is_known
    if drive.objective == "localized factor":
        return float(10 * np.log10(drive.value / value)), is_one_tone, is_known
    return float(drive.value - value), is_one_tone, is_known


def print_steady_bench(out: Console, result: dict[str, Any]) -> None:
    """Times by number of fingers, and the comparison with the tabulated search."""
    out.print(f"{result['machine']}; {result['device']}, {result['actuators']} actuators", highlight=False)
    for fingers, ms in result["solve_ms"].items():
        out.print(f"{fingers} fingers: {ms['median']:.2f} ms (median), {ms['p95']:.2f} ms (95 %)", highlight=False)
    own = result["tabulated"]
    out.print(
        f"{own['entries']} entries with {own['sampled_cases']} sampled cases: {own['ms_per_entry'][1]:.2f} ms each; "
        f"the tabulated search takes {own['ratio']:.0f} times as long, and reaches {own['unreached']} levels more",
        highlight=False,
    )
    for name, each in own["difference_db"].items():
        out.print(
            f"{name.replace('_', ' ')}: {each['entries']} entries, {each['median']:+.3f} dB (median), "
            f"{each['worst']:+.3f} dB at worst against the tabulated drive",
            highlight=False,
        )
