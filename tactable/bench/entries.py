"""Time and memory of the entries of a device, beside a general-purpose solver (SLSQP) on the same problems."""

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
from threadpoolctl import threadpool_limits

from engine.device import Device
from engine.touch import ZoneState
from precompute.entries.candidate import powers_of
from precompute.entries.objective import DEFAULT_OBJECTIVE, OBJECTIVES, Problem
from precompute.entries.prediction import States, touched_zones
from precompute.entries.solver import EntrySolver, tabulated_states
from precompute.model.assembly import assemble

Array = NDArray[np.float64]

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
    """Seconds, memory and the ratio to SLSQP."""
    own = result["device"]
    out.print(f"{result['machine']}; {result['levels']} levels, {result['step_hz']} Hz", highlight=False)
    out.print(
        f"{own['states']} states in {own['all_states_s']:.1f} s, {1e3 * own['s_per_entry']:.1f} ms an entry (median "
        f"gap {own['median_gap_db']:.3f} dB), {own['memory_mib']:.0f} MiB at most; SLSQP from {_SLSQP_STARTS} starts "
        f"takes {result['slsqp_ratio']:.0f} times as long for an entry",
        highlight=False,
    )
