"""How long the decoder takes for a report: every report of the recordings given, each timed by itself."""

import gc
import platform
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table as Grid

from engine.touch import open_digitizer
from engine.touch.sources.recording import Recording, read_recording

ROUNDS = 5


def run_decode_bench(paths: Sequence[Path]) -> dict[str, Any]:
    """Time the decoding of all reports, `ROUNDS` times. Raises what reading and opening a recording raises."""
    recordings = [read_recording(path) for path in paths]
    rows = []
    for path, recording in zip(paths, recordings, strict=True):
        if recording.reports:
            rows.append({"recording": path.name, "reports": len(recording.reports), **summarise(time_ours(recording))})
    everything = np.concatenate([time_ours(recording) for recording in recordings])
    return {
        "machine": {"python": platform.python_version(), "rounds": ROUNDS, "clock_ns": clock_cost_ns()},
        "reports": sum(len(recording.reports) for recording in recordings),
        **summarise(everything),
        "recordings": rows,
    }


def time_ours(recording: Recording) -> NDArray[np.int64]:
    """Nanoseconds of each report in each round, the clock's own cost taken off."""
    reports = [(report.data, round(report.time_s * 1e9)) for report in recording.reports]
    samples = []
    for _ in range(ROUNDS):
        digitizer = open_digitizer(recording.descriptor, recording.vendor_id, recording.product_id)
        samples.append(time_calls(digitizer.decode_report, reports))
    return np.concatenate(samples)


def time_calls(function: Callable[..., object], arguments: Sequence[tuple[Any, ...]]) -> NDArray[np.int64]:
    """Nanoseconds of each call, the clock's own cost taken off; the garbage collector waits, as in the loop."""
    clock, times = time.perf_counter_ns, np.zeros(len(arguments), np.int64)
    collects = gc.isenabled()
    gc.disable()
    try:
        for i, values in enumerate(arguments):
            start_ns = clock()
            function(*values)
            times[i] = clock() - start_ns
    finally:
        if collects:
            gc.enable()
    return np.maximum(times - clock_cost_ns(), 0)


def clock_cost_ns() -> int:
    """What one reading of the clock costs: the median of 1000."""
    readings = [time.perf_counter_ns() for _ in range(1001)]
    return int(np.median(np.diff(readings)))


def summarise(times_ns: NDArray[np.int64]) -> dict[str, float]:
    """Median, 99th percentile and mean in microseconds; None of them for no report."""
    if not len(times_ns):
        return {}
    median, p99 = np.percentile(times_ns, [50, 99])
    return {"median_us": median / 1e3, "p99_us": p99 / 1e3, "mean_us": float(times_ns.mean()) / 1e3}


def print_decode_bench(out: Console, result: dict[str, Any]) -> None:
    """The same as a table."""
    grid = Grid("recording", "reports", "median µs", "p99 µs", "mean µs")
    for row in (*result["recordings"], {**result, "recording": "all"}):
        figures = [f"{row[key]:.2f}" if key in row else "-" for key in ("median_us", "p99_us", "mean_us")]
        grid.add_row(row["recording"], str(row["reports"]), *figures)
    out.print(grid)
