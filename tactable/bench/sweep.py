"""Speed of the sweep of a table, beside the floor that the memory sets, measured in the same run."""

import platform
import statistics
import time
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numba import njit, prange
from rich.console import Console
from rich.table import Table as Grid
from threadpoolctl import threadpool_limits

from engine.device import Device
from precompute.model.assembly import assemble_bar
from precompute.sweep.grid import compute_grid_response, zone_points
from precompute.sweep.tabulate import pair_filler

ROUNDS = 5  # of each task, in turn; their median is shown


def run_sweep_bench(device: Device) -> dict[str, Any]:
    """Time the pair sweep of the first two actuators of `device` against writing as many bytes. Takes some seconds."""
    with threadpool_limits(1, "blas"):
        grid = compute_grid_response(assemble_bar(device), device.sweep.frequency_hz, zone_points(device))
        fill = pair_filler(grid, (0, 1))
        count, steps = len(grid.frequency_hz), device.sweep.amplitude_steps + 1
        shape = (count, steps * steps, len(device.zones), count)
        out = [np.zeros(shape, dtype=np.float32) for _ in range(3)]
        ours, floor = _interleaved(lambda: fill(slice(None), out), lambda: _write_floor(*out))
        points = count * count * steps * steps
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
    }


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


def print_sweep_bench(out: Console, result: dict[str, Any]) -> None:
    """Print the figures as a table."""
    grid = Grid("what", "time", "ratio to ours", title=f"{result['values']:.3g} values, {result['device']}")
    ours = result["sweep_s"]
    rows = (
        ("our sweep", ours, "1"),
        ("floor: the same bytes written to memory", result["memory_floor_s"], f"1 / {result['times_the_floor']:.1f}"),
    )
    for name, seconds, ratio in rows:
        grid.add_row(name, f"{seconds:.4g} s", ratio)
    out.print(grid)
    out.print(f"{result['values_per_s']:.3g} table values a second on {result['machine']['threads']} threads")
