"""Speed of the sweep of a table: each figure beside a floor or a rival measured in the same run."""

import platform
import statistics
import time
from collections.abc import Callable, Sequence
from typing import Any

import numba
import numpy as np
import scipy.linalg
from numba import njit, prange
from rich.console import Console
from rich.table import Table as Grid
from threadpoolctl import threadpool_limits

from base.arrays import Array, Points, Single
from engine.device import Device
from precompute.model.assembly import BarPlant, assemble_bar
from precompute.model.transfers import transfers_at
from precompute.sweep.grid import GridResponse, compute_grid_response, zone_points
from precompute.sweep.tabulate import PairSweep, prepare_pair_sweep

ROUNDS = 5  # of each task, in turn; their median is shown
TWIN_ROWS = 8  # rows of frequency_1 that the NumPy twin computes: it is timed on these and scaled up
SAMPLED_POINTS = 40  # some milliseconds each; their mean is scaled up, and the output says so


def run_sweep_bench(device: Device) -> dict[str, Any]:
    """Time the pair sweep of the first two actuators of `device` against its rivals. Takes about half a minute."""
    with threadpool_limits(1, "blas"):
        plant = assemble_bar(device)
        grid = compute_grid_response(plant, device.sweep.frequency_hz, zone_points(device))
        sweep = prepare_pair_sweep(grid, (0, 1))
        count, steps = len(grid.frequency_hz), device.sweep.amplitude_steps + 1
        shape = (count, steps * steps, len(device.zones), count)
        out = [np.zeros(shape, dtype=np.float32) for _ in range(3)]
        rows = slice(0, TWIN_ROWS)
        ours, floor, twin = _interleaved(
            lambda: sweep.fill(slice(None), out),
            lambda: _write_floor(*out),
            lambda: numpy_twin(sweep, rows, [values[rows] for values in out]),
        )
        twin *= count / TWIN_ROWS
        points = count * count * steps * steps
        point_s = _time_points(plant, grid)
    table_bytes = sum(values.nbytes for values in out)
    return {
        "device": device.name,
        "machine": {"python": platform.python_version(), "threads": numba.get_num_threads(), "rounds": ROUNDS},
        "points": points,
        "values": 3 * points * len(device.zones),
        "table_bytes": table_bytes,
        "sweep_s": ours,
        "values_per_s": 3 * points * len(device.zones) / ours,
        "memory_floor_s": floor,
        "times_the_floor": ours / floor,
        "numpy_twin_s": twin,
        "numpy_twin_note": f"EXTRAPOLATED from {TWIN_ROWS} of {count} rows",
        "times_faster_than_numpy": twin / ours,
        "point_by_point_s": point_s * points,
        "point_by_point_note": f"EXTRAPOLATED from {SAMPLED_POINTS} points, {1e3 * point_s:.2f} ms each",
        "times_faster_than_point_by_point": point_s * points / ours,
    }


def numpy_twin(sweep: PairSweep, rows: slice, out: Sequence[Single]) -> None:
    """Pair sweep in vectorised NumPy: one pass for each ratio and row, then scaled to the amplitudes."""
    ratios = sweep.ratios
    factor, peak, dead = out
    level_2, energy_2, total_2 = sweep.level_2, sweep.energy_2, sweep.total_2
    index, multiple = ratios.ratio.ravel(), ratios.multiple.ravel().astype(np.float32)
    for row, f1 in enumerate(range(rows.start, rows.stop)):
        for r, (u, v) in enumerate(zip(ratios.first, ratios.second, strict=True)):
            level = u * sweep.level_1[f1][:, :, None] + v * level_2
            high, low = level.max(axis=1), level.min(axis=1)
            share = (u * u * sweep.energy_1[f1][:, None] + v * v * energy_2) / (
                u * u * sweep.total_1[f1] + v * v * total_2
            )
            for k in np.flatnonzero(index == r):
                factor[row, k] = share
                np.multiply(high, multiple[k], out=peak[row, k])
                np.multiply(low, multiple[k], out=dead[row, k])
        for figure in out:
            figure[row, multiple == 0] = np.nan


def _interleaved(*tasks: Callable[[], object]) -> list[float]:
    """Median time of each task, in seconds, taken in turn so that all see the same machine; one round to warm up."""
    times: list[list[float]] = [[] for _ in tasks]
    for _ in range(ROUNDS + 1):
        for task, kept in zip(tasks, times, strict=True):
            start = time.perf_counter()
            task()
            kept.append(time.perf_counter() - start)
    return [statistics.median(kept[1:]) for kept in times]


@njit(parallel=True)
def _write_floor(factor, peak, dead):  # type: ignore[no-untyped-def]  # numba
    """Write as many bytes as the sweep does, on as many threads."""
    for row in prange(factor.shape[0]):
        factor[row] = np.float32(1)
        peak[row] = np.float32(2)
        dead[row] = np.float32(3)


def _time_points(plant: BarPlant, grid: GridResponse) -> float:
    """Seconds a point the way of the paper: solve the model for each (f1, f2, a1, a2), then read the figures off."""
    pairs_hz = np.random.default_rng(0).choice(grid.frequency_hz, size=(SAMPLED_POINTS, 2))
    start = time.perf_counter()
    for pair_hz in pairs_hz:
        solve_point(plant, grid.position_m, pair_hz, np.array([0.6, 0.8]))
    return (time.perf_counter() - start) / SAMPLED_POINTS


def solve_point(plant: BarPlant, position_m: Points, pair_hz: Array, amplitude: Array) -> tuple[Array, Array]:
    """Localized factor and peak of every zone for two tones, by SciPy's banded solver on the assembled matrices."""
    zones = len(plant.device.zones)
    energy, level = np.zeros(zones + 1), np.zeros(position_m.shape)
    for actuator, dof, hz, weight in zip(plant.device.actuators, plant.actuator_dof, pair_hz, amplitude, strict=False):
        omega = 2 * np.pi * hz
        band = plant.K + 1j * omega * plant.C - omega**2 * plant.M
        full = np.zeros((7, plant.size), dtype=np.complex128)
        full[:4] = band
        for k in range(1, 4):
            full[3 + k, : plant.size - k] = band[3 - k, k:]
        load = np.zeros(plant.size, dtype=np.complex128)
        load[dof] = actuator.spring_force_n + 1j * omega * actuator.damper_force_n_s
        factors = transfers_at([actuator], 1j * np.atleast_1d(omega))
        factor = 1.0 if factors is None else factors[0, 0]
        field = weight * factor * scipy.linalg.solve_banded((3, 3), full, load)
        local = omega * field[plant.element_dof]
        element = np.einsum("ei,eij,ej->e", local.conj(), plant.element_integral, local).real
        energy += np.bincount(plant.element_zone, element, zones + 1)
        level += omega**2 * abs(plant.sampler(position_m.ravel()).sample(field)).reshape(position_m.shape)
    return energy[:-1] / energy.sum(), level.max(axis=1)


def print_sweep_bench(out: Console, result: dict[str, Any]) -> None:
    """Print the figures as a table."""
    grid = Grid("what", "time", "ratio to ours", title=f"{result['values']:.3g} values, {result['device']}")
    ours = result["sweep_s"]
    rows = (
        ("our sweep", ours, "1"),
        ("floor: the same bytes written to memory", result["memory_floor_s"], f"1 / {result['times_the_floor']:.1f}"),
        ("NumPy twin (extrapolated)", result["numpy_twin_s"], f"{result['times_faster_than_numpy']:.0f}"),
        (
            "model solved point by point (extrapolated)",
            result["point_by_point_s"],
            f"{result['times_faster_than_point_by_point']:.2g}",
        ),
    )
    for name, seconds, ratio in rows:
        grid.add_row(name, f"{seconds:.4g} s", ratio)
    out.print(grid)
    out.print(f"{result['values_per_s']:.3g} table values a second on {result['machine']['threads']} threads")
