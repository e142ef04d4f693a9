"""A fleet of 200 small bars, five of them broken, on one process and on several, a worker killed on the way.

python -m tests.studies.cost.fleet_of_two_hundred UNITS WORKERS
"""

import multiprocessing
import os
import platform
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from precompute.fleet.fleet_plan import plan_fleet
from precompute.fleet.fleet_run import run_fleet, run_on_processes
from precompute.fleet.summary import summarise
from precompute.fleet.units import FleetOptions
from tests.precompute.fleet.small_fleet import small_text, write_measurements, write_unit
from tests.precompute.fleet.test_fleet_run import BROKEN, assert_complete, write_broken

MEASURED_EVERY = 20
ODD = "0017"
"""Its stiffness is none of the line's."""


def write_fleet(bars: Path, count: int) -> None:
    """`count` units: five broken, one odd, every 20th measured."""
    random = np.random.default_rng(0)
    write_broken(bars)
    write_unit(bars / "zoneless-too", small_text().replace("count = 2", "count = 99"))
    for i in range(count - len(BROKEN) - 1):
        name, stiffness = f"{i:04d}", 18.9 * (1 + 0.01 * random.standard_normal())
        folder = write_unit(bars / name, small_text(f"{25.0 if name == ODD else stiffness:.4f} kN/m"))
        if i % MEASURED_EVERY == 0:
            write_measurements(folder, small_text(f"{stiffness + 0.3:.4f} kN/m"))


def timed(bars: Path, out: Path, workers: int, kill: bool) -> float:
    """Seconds for all of it; every good unit is complete, every bad one named, the odd one stands out."""
    killed = list[str]()

    def told(_step: str, fraction: float) -> None:
        if kill and fraction > 0.3 and not killed:
            worker = multiprocessing.active_children()[0]
            worker.kill()
            killed.append(worker.name)

    units, start_s = plan_fleet(bars), time.perf_counter()
    outcomes = run_fleet(units, FleetOptions(clicks_up_to=0), out, run_on_processes(workers), created="", progress=told)
    spent_s = time.perf_counter() - start_s
    summary = summarise(units, outcomes)
    assert {outcome.name for outcome in summary.failed} == {*BROKEN, "zoneless-too"}, summary.failed
    for outcome in outcomes:
        if outcome.error is None:
            assert_complete(out / outcome.name)
    assert ODD in {outlier.unit for outlier in summary.outliers}
    print(f"{len(units)} units, {workers} workers{', one killed' * kill}: {spent_s:.1f} s,", end=" ")
    print(f"{len(summary.failed)} failed, load {os.getloadavg()[0]:.1f}", flush=True)
    return spent_s


def main() -> None:
    """Print times and the speed-up."""
    count, workers = map(int, sys.argv[1:])
    print(f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}")
    with tempfile.TemporaryDirectory() as folder:
        bars = Path(folder, "bars")
        bars.mkdir()
        write_fleet(bars, count)
        killed_s = timed(bars, Path(folder, "killed"), workers, kill=True)
        one_s = timed(bars, Path(folder, "one"), 1, kill=False)
        several_s = timed(bars, Path(folder, "several"), workers, kill=False)
    print(f"speed-up {one_s / several_s:.2f}, with a worker killed {one_s / killed_s:.2f}")


if __name__ == "__main__":
    main()
