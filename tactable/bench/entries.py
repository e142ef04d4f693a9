"""Entries: their time and memory beside a general-purpose solver, and their contrast beside the paper's objective."""

import itertools
import os
import platform
import resource
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.optimize
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table as Grid
from threadpoolctl import threadpool_limits

from engine.device import Device
from engine.table import Entry, Table
from engine.touch import ZoneState
from precompute.entries.alternatives import paper_drive
from precompute.entries.found_drive import powers_of
from precompute.entries.objective import DEFAULT_OBJECTIVE, OBJECTIVES, Problem
from precompute.entries.prediction import States, touched_zones
from precompute.entries.solver import EntrySolver, tabulated_states
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.model.transient import TransientPlant

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

STEP_HZ = 0.5
_SLSQP_STARTS = 20
_SLSQP_STATES = 3


def run_states_bench(device: Device) -> dict[str, Any]:
    """Time and memory of all the device's states, and how many times as long SLSQP takes for an entry."""
    device = replace(device, sweep=replace(device.sweep, step_hz=STEP_HZ))
    with threadpool_limits(1, "blas"):
        own = time_entries(device, sorted(tabulated_states(device), key=touched_zones))
        rival_s = _time_slsqp(device)
    return {
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}",
        "step_hz": STEP_HZ,
        "levels": len(device.levels_db) + 1,
        "device": own,
        "slsqp_s_per_entry": rival_s,
        "slsqp_ratio": rival_s / own["s_per_entry"],
    }


def time_entries(device: Device, chosen: Sequence[States]) -> dict[str, Any]:
    """Seconds for the entries of all states of the device, extrapolated from the `chosen` ones; memory."""
    solver = EntrySolver(assemble(device))
    solver.solve(chosen[0])  # compiles the kernels and fills the machine's caches
    start_s = time.perf_counter()
    solver = EntrySolver(assemble(device))
    gaps_db = [entry.optimality_gap_db for state in chosen for entry in solver.solve(state)]
    spent_s, states = time.perf_counter() - start_s, len(tabulated_states(device))
    return {
        "zones": len(device.zones),
        "actuators": len(device.actuators),
        "states": states,
        "solved": len(chosen),
        "all_states_s": spent_s * states / len(chosen),
        "s_per_entry": spent_s / len(gaps_db),
        "median_gap_db": float(np.median(gaps_db)),
        "memory_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


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
        turned: Complex = np.exp(1j * x[count + 1 :])
        amplitude: Complex = x[1 : count + 1] * turned
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
    """Seconds, memory and the ratio to SLSQP."""
    own = result["device"]
    out.print(f"{result['machine']}; {result['levels']} levels, {result['step_hz']} Hz", highlight=False)
    out.print(
        f"{own['states']} states in {own['all_states_s']:.1f} s, {1e3 * own['s_per_entry']:.1f} ms an entry (median "
        f"gap {own['median_gap_db']:.3f} dB), {own['memory_mib']:.0f} MiB at most; SLSQP from {_SLSQP_STARTS} starts "
        f"takes {result['slsqp_ratio']:.0f} times as long for an entry",
        highlight=False,
    )


# ---- contrast ---------------------------------------------------------------------------------------------

_SAMPLES_PER_CYCLE = 100
_SETTLING_S, _WINDOW_S = 4.0, 0.2


def run_contrast_bench(table: Table, level_db: float) -> dict[str, Any]:
    """Contrast of both drives in the loaded plant by frequency response and in the time-domain plant. SIMULATED."""
    with threadpool_limits(1, "blas"):
        solver = EntrySolver(assemble(table.device))
        bar = TimeDomain(table.device)
        rows = [
            _compare_contrast(table, solver, bar, pair, level_db)
            for pair in itertools.permutations(range(len(table.device.zones)), 2)
        ]
    return {"simulated": True, "device": table.device.name, "level_db": level_db, "states": rows}


class TimeDomain:
    """The time-domain plant of a device with standard fingers on it."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._basis = compute_basis(assemble(device))

    def levels_under(self, entry: Entry) -> Array:
        """Peak acceleration in m/s^2 under each finger of the entry's state, after the drive was held until steady."""
        middles_m = [(zone.start_m + zone.stop_m) / 2 for zone in self._device.zones]
        at_m = np.array([middles_m[zone] for zone in touched_zones(entry.states)])
        rate_hz = _SAMPLES_PER_CYCLE * max(entry.frequencies_hz)
        plant = TransientPlant(self._basis, at_m, rate_hz)
        plant.touch([(position_m, self._device.finger) for position_m in at_m.tolist()])
        time_s = np.arange(round((_SETTLING_S + _WINDOW_S) * rate_hz)) / rate_hz
        turn = 2 * np.pi * time_s[:, None] * np.array(entry.frequencies_hz) + np.array(entry.phases_rad)
        acceleration = plant.accelerate(np.array(entry.amplitudes) * np.cos(turn))
        peak: Array = abs(acceleration[time_s >= _SETTLING_S]).max(axis=0)
        return peak


def _compare_contrast(
    table: Table, solver: EntrySolver, bar: TimeDomain, pair: tuple[int, int], level_db: float
) -> dict[str, Any]:
    felt, quiet = (table.device.zones[zone].name for zone in pair)
    states = table.states_of([felt], [quiet])
    ours = table.entry_for([felt], [quiet], level_db)
    paper = solver.evaluate(states, level_db, paper_drive(solver, states), "paper")
    return {"felt": felt, "quiet": quiet, "paper": _contrast_figures(bar, paper), "ours": _contrast_figures(bar, ours)}


def _contrast_figures(bar: TimeDomain, entry: Entry) -> dict[str, Any]:
    level = bar.levels_under(entry)
    kinds = [state for state in entry.states if state is not ZoneState.FREE]
    measured_db = 20 * np.log10(level[kinds.index(ZoneState.FELT)] / level[kinds.index(ZoneState.QUIET)])
    return {
        "frequencies_hz": list(entry.frequencies_hz),
        "level_db": entry.level_db,
        "contrast_db": entry.contrast_db,
        "time_domain_contrast_db": float(measured_db),
        "expected_contrast_db": entry.expected_contrast_db,
        "worst_contrast_db": entry.worst_case.contrast_db,
    }


def print_contrast_bench(out: Console, result: dict[str, Any]) -> None:
    """The states as a table: contrast in dB in the loaded plant / in the time-domain plant, expected, level reached."""
    grid = Grid(
        "felt",
        "quiet",
        "paper: dB",
        "in time",
        "expected",
        "level",
        "ours: dB",
        "in time",
        "expected",
        "level",
        title=f"{result['device']}, {result['level_db']:g} dB wanted, fingers on the bar, SIMULATED",
    )
    for row in result["states"]:
        cells = [row["felt"], row["quiet"]]
        for who in ("paper", "ours"):
            keys = ("contrast_db", "time_domain_contrast_db", "expected_contrast_db", "level_db")
            cells += [f"{row[who][key]:.1f}" for key in keys]
        grid.add_row(*cells)
    out.print(grid)
