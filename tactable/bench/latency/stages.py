"""Durations of the stages from report to actuator, their percentiles, misses, and the layer that costs most."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np

from base.arrays import Array
from engine.loop.observer import Percentiles

Stamps = Array  # shape (sample, point): ns after the report was due, NaN where a point was not measured
Values = Array

MISSES_MS = (1, 5, 10, 20, 50)  # a frame of the fastest digitizers, to what is felt as late (50 ms, Kaaresoja 2014)
_LEAST_BEYOND = 10  # docs/latency.md: of fewer, a percentile is chance
_US = 1e3
_MS = 1e6


class Point(IntEnum):
    """Points on the way of a report, on one clock. Each but the first ends a stage."""

    DUE = 0  # the schedule says that the report is sent
    SENT = 1  # the digitizer has sent it
    READ = 2
    FRAME = 3
    STATE = 4
    COMMAND = 5
    WRITTEN = 6  # the port has taken the whole command
    RECEIVED = 7  # the far end of the line has it
    APPLIED = 8  # the firmware plays it
    AT_FINGER = 9  # the vibration first passes the detection threshold under the last felt finger, as the table says


@dataclass(frozen=True)
class StageOf:
    """Name of a stage, the layer that is to blame for it, and what lies in it."""

    name: str
    layer: str
    meaning: str


STAGES = {
    Point.SENT: StageOf("digitizer", "digitizer", "due until sent: the digitizer, or here its stand-in, was late"),
    Point.READ: StageOf("wake-up", "host", "sent until read: the operating system wakes the engine"),
    Point.FRAME: StageOf("decode", "engine", "read until the touch frame is complete"),
    Point.STATE: StageOf("state", "engine", "fingers, their roles and what is wanted"),
    Point.COMMAND: StageOf("look-up", "engine", "click of the fingers, handed to the link"),
    Point.WRITTEN: StageOf("encode and write", "link", "command frame made, and taken by the port"),
    Point.RECEIVED: StageOf("line", "link", "taken by the port until the other end has it"),
    Point.APPLIED: StageOf("device", "device", "received until the firmware plays it"),
    Point.AT_FINGER: StageOf(
        "bar (simulated)", "bar", "played until it passes the threshold at the finger: by the table, not measured"
    ),
}
MEASURED_POINTS = tuple(point for point in STAGES if point is not Point.AT_FINGER)


def figures_of(durations_ns: Values) -> dict[str, float | None] | None:
    """Count and percentiles in us, with the jitter p90 - p10; None without a sample.

    A percentile beyond which fewer than ten samples lie is None: it would be one of them, and no estimate of anything.
    """
    found = Percentiles.of(durations_ns)
    if found is None:
        return None
    # Each with its share: one sample in this many lies beyond it.
    tails = (("p90", found.p90_ns, 10), ("p99", found.p99_ns, 100), ("p99_9", found.p99_9_ns, 1_000))
    tails_us = {
        f"{name}_us": ns / _US if found.count >= _LEAST_BEYOND * share else None
        for name, ns, share in (*tails, ("p99_99", found.p99_99_ns, 10_000))
    }
    jitter_us = (found.p90_ns - found.p10_ns) / _US
    median_us, greatest_us = found.p50_ns / _US, found.max_ns / _US
    return {"count": found.count, "p50_us": median_us, **tails_us, "max_us": greatest_us, "jitter_us": jitter_us}


def durations_of(stamps: Stamps, point: Point) -> Values:
    """Durations (sample,) of the stage that ends with a point, ns, from the last known point before it."""
    before = stamps[:, :point]
    known = np.where(np.isfinite(before), np.arange(int(point)), -1).max(axis=1)
    return stamps[:, point] - before[np.arange(len(stamps)), known]


def last_measured(stamps: Stamps) -> Point:
    """The last measured point that most samples have: some firmware reports for few commands when it applied them."""
    measured = [point for point in MEASURED_POINTS if 2 * np.isfinite(stamps[:, point]).sum() > len(stamps)]
    return measured[-1] if measured else Point.DUE


def stages_json(stamps: Stamps) -> dict[str, Any]:
    """Figures of every stage, and of the ways to WRITTEN and to the last measured point."""
    stages = {stage.name: figures_of(durations_of(stamps, point)) for point, stage in STAGES.items()}
    wholes = {
        "due to written": figures_of(stamps[:, Point.WRITTEN]),
        "sent to written": figures_of(stamps[:, Point.WRITTEN] - stamps[:, Point.SENT]),
        "read to written": figures_of(stamps[:, Point.WRITTEN] - stamps[:, Point.READ]),
        f"due to {last_measured(stamps).name.lower()}": figures_of(stamps[:, last_measured(stamps)]),
    }
    told = {name: figures for name, figures in (wholes | stages).items() if figures is not None}
    return {"stages": told, "misses": misses_of(stamps[:, Point.WRITTEN])}


def misses_of(durations_ns: Values) -> dict[str, int]:
    """Number of samples over each limit; a command that was never written counts too."""
    late = ~(durations_ns[:, None] <= _MS * np.array(MISSES_MS))
    return {f"{limit} ms": int(count) for limit, count in zip(MISSES_MS, late.sum(axis=0), strict=True)}


def blame(stamps: Stamps) -> dict[str, Any] | None:
    """The layer that most of the median is spent in, and the layer in which the slowest hundredth lost its time.

    The second compares each stage of the slowest samples with its own median. None without a sample.
    """
    durations = {stage: durations_of(stamps, point) for point, stage in STAGES.items() if point in MEASURED_POINTS}
    known = {stage: values for stage, values in durations.items() if np.isfinite(values).any()}
    if not known:
        return None
    # The buffer of a line that stands still takes some commands: they are written in time and arrive late.
    whole = np.fmax(stamps[:, Point.WRITTEN], stamps[:, Point.RECEIVED])
    slowest = whole >= np.nanpercentile(whole, 99)
    medians = {stage: float(np.nanmedian(values)) for stage, values in known.items()}
    excess = {stage: float(np.nansum(values[slowest] - medians[stage])) for stage, values in known.items()}
    return {"typical": _greatest(medians), "slowest": _greatest(excess)}


def _greatest(costs: Mapping[StageOf, float]) -> dict[str, Any]:
    """The costliest layer, its costliest stage, and the layer's share of the total."""
    layers: dict[str, float] = {}
    for stage, cost in costs.items():
        layers[stage.layer] = layers.get(stage.layer, 0.0) + max(0.0, cost)
    layer = max(layers, key=lambda name: layers[name])
    stage = max((stage for stage in costs if stage.layer == layer), key=lambda stage: costs[stage])
    total = sum(layers.values())
    return {"layer": layer, "stage": stage.name, "share": layers[layer] / total if total else 0.0}


def us(value: float | None) -> str:
    """Microseconds with about three digits; a dash where too few samples tell."""
    if value is None or not math.isfinite(value):
        return "-"
    return f"{value:.1f}" if value < 1000 else f"{value:.0f}"
