"""Our decoder beside hid-tools on the same reports; hid-tools is GPL and only measured, never part of the product.

    python -m venv /tmp/hid-tools && /tmp/hid-tools/bin/pip install hid-tools numpy rich
    PYTHONPATH=. /tmp/hid-tools/bin/python -m tests.tools.compare_hid_tools ../shared/recordings/touch/*.hid

Two figures of hid-tools: the values of every field of the report (`HidField.get_values`, the least it can do), and the
decoded report as its own `hid-decode` makes it (`format_report`). Ours is the finished touch frame. Calls are timed in
turn, a recording at a time, so that all see the same machine. Exit status 1 when we are not 10 times faster.
"""

from __future__ import annotations

import gc
import importlib
import json
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from engine.loop.latency import Percentiles
from engine.touch import open_digitizer
from engine.touch.sources.recording import Recording, read_recording

WANTED = 10.0


def main(paths: list[Path]) -> int:
    """Print the figures as JSON."""
    hid: Any = importlib.import_module("hidtools.hid")
    samples: dict[str, list[Any]] = {"tactable": [], "hid_tools_values": [], "hid_tools_decode": []}
    refused = []
    for path in paths:
        recording = read_recording(path)
        if not recording.reports:
            continue
        try:
            theirs = hid.ReportDescriptor.from_bytes(recording.descriptor)
            values, decode = reader(theirs), decoder(theirs)
            for data in reports_of(recording):
                values(*data), decode(*data)
        except Exception as error:  # whatever it does not read is said and left out
            refused.append(f"{path.name}: {error!r}")
            continue
        digitizer = open_digitizer(recording.descriptor, recording.vendor_id, recording.product_id)
        timed = [(report.data, round(report.time_s * 1e9)) for report in recording.reports]
        samples["tactable"].append(time_calls(digitizer.decode_report, timed))
        samples["hid_tools_values"].append(time_calls(values, reports_of(recording)))
        samples["hid_tools_decode"].append(time_calls(decode, reports_of(recording)))
    result: dict[str, Any] = {name: figures_of(np.concatenate(times)) for name, times in samples.items()}
    for figure in ("median_us", "p99_us"):
        for rival in ("hid_tools_values", "hid_tools_decode"):
            result[rival]["times_" + figure.removesuffix("_us")] = result[rival][figure] / result["tactable"][figure]
    result["recordings"], result["not_read_by_hid_tools"] = len(samples["tactable"]), refused
    print(json.dumps(result, indent=2))  # noqa: T201  # the result
    return int(result["hid_tools_decode"]["times_median"] < WANTED)


def figures_of(times_ns: Any) -> dict[str, float]:
    """Median and 99th percentile in us; none for no report."""
    found = Percentiles.of(times_ns)
    return {"median_us": found.p50_ns / 1e3, "p99_us": found.p99_ns / 1e3} if found else {}


def time_calls(function: Callable[..., object], arguments: Sequence[tuple[Any, ...]]) -> Any:
    """Ns of each call (call,); garbage waits, as it does in the loop."""
    clock, times = time.perf_counter_ns, np.zeros(len(arguments), np.int64)
    gc.disable()
    for i, values in enumerate(arguments):
        start_ns = clock()
        function(*values)
        times[i] = clock() - start_ns
    gc.enable()
    return times


def reports_of(recording: Recording) -> list[tuple[list[int]]]:
    """As hid-tools wants them: lists of numbers."""
    return [(list(report.data),) for report in recording.reports]


def reader(descriptor: Any) -> Callable[[list[int]], object]:
    """Values of all fields of a report."""

    def read(data: list[int]) -> object:
        report = descriptor.get(data[0], len(data))
        return None if report is None else [field.get_values(data) for field in report]

    return read


def decoder(descriptor: Any) -> Callable[[list[int]], object]:
    """The report as hid-decode prints it."""
    return lambda data: descriptor.format_report(data)


if __name__ == "__main__":
    sys.exit(main([Path(argument) for argument in sys.argv[1:]]))
