"""Clicks of a grid of placements, shared among Dask workers of one thread: what a second worker brings."""

import time
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from itertools import combinations
from typing import Any, TypeVar

import distributed
import numpy as np

from engine.device import Device
from engine.touch import Placement
from precompute.clicks import ClickOptions, ClickSolver

APART_M = 15e-3
"""Fingers of a placement are at least this far apart."""
Result = TypeVar("Result")


def measure_workers(
    device: Device, options: ClickOptions, placements: Sequence[Placement], counts: Sequence[int]
) -> list[dict[str, Any]]:
    """One row for each number of Dask workers with one thread: seconds until all clicks are back, and those computed.

    A worker's solver is made before, and its time told apart: it is the same however many placements there are.
    """
    rows = []
    for workers in counts:
        cluster = distributed.LocalCluster(  # type: ignore[no-untyped-call]
            n_workers=workers, threads_per_worker=1, memory_limit=None, dashboard_address="127.0.0.1:0"
        )
        with cluster, distributed.Client(cluster) as client:  # type: ignore[no-untyped-call]
            ready_s = max(client.run(_time_in_worker, device, options, placements[0]).values())
            start_s = time.perf_counter()
            solve = partial(_time_in_worker, device, options)
            solved_s = client.gather(client.map(solve, placements[1:], pure=False))
            rows.append(
                {
                    "workers": workers,
                    "clicks": len(placements) - 1,
                    "wall_s": time.perf_counter() - start_s,
                    "processor_s": sum(solved_s),
                    "ready_s": ready_s,
                }
            )
    return rows


@lru_cache(maxsize=1)
def _solver_of(device: Device, options: ClickOptions) -> ClickSolver:
    """The solver of a worker, which has one for all its clicks."""
    return ClickSolver(device, options)


def _time_in_worker(device: Device, options: ClickOptions, placement: Placement) -> float:
    return timed(lambda: _solver_of(device, options).solve(placement))[1]


def timed(call: Callable[[], Result]) -> tuple[Result, float]:
    """What `call` gives, and its seconds of processor time."""
    start_s = time.process_time()
    result = call()
    return result, time.process_time() - start_s


def grid_of(device: Device, count: int) -> list[Placement]:
    """`count` placements of one felt and one quiet finger on the coarsest even grid that has as many."""
    places = 2
    while True:
        at_m = np.linspace(0.0, device.bar.length_m, places).tolist()
        found = [
            Placement((a, b), is_felt)
            for a, b in combinations(at_m, 2)
            if b - a >= APART_M
            for is_felt in ((True, False), (False, True))
        ]
        if len(found) >= count:
            return [found[i] for i in np.linspace(0, len(found) - 1, count).round().astype(int)]
        places += 1
