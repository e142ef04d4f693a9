"""A capture of a scope - touch, device echo, acceleration - to the same report as a measurement of ours."""

import csv
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactable.bench.latency.report import FORMAT, REVISION, LatencyReportError
from tactable.bench.latency.stages import Values, figures_of, misses_of

Array = NDArray[np.float64]

TIME, TOUCH, ECHO, ACCELERATION = "time_s", "touch_v", "echo_v", "acceleration_m_per_s2"
_NS_PER_S = 1e9
# What follows a touch later than this belongs to something else.
_LONGEST_S = 0.5
# Of the noise before the touch: reached by chance once in 1e9 samples.
_NOISES = 6.0
_NOISE_OF_DEVIATION = 1.4826  # median absolute deviation to standard deviation, of a normal distribution


@dataclass(frozen=True)
class Capture:
    """Channels over time, shape (sample,) each; an absent one is None."""

    path: Path
    time_s: Array
    touch_v: Array
    echo_v: Array | None
    acceleration: Array | None

    @property
    def step_s(self) -> float:
        """From sample to sample: no edge is known better."""
        return float(np.median(np.diff(self.time_s)))


def read_capture(path: Path) -> Capture:
    """A table of numbers with a header that names the columns and their units (docs/latency.md).

    Raises LatencyReportError naming row and column of what is no number, and what is missing.
    """
    with path.open(newline="", encoding="utf-8") as file:
        head, *rows = list(csv.reader(file)) or [[]]
    names = [name.strip() for name in head]
    known = (TIME, TOUCH, ECHO, ACCELERATION)
    unknown = [name for name in names if name not in known]
    if unknown or TIME not in names or TOUCH not in names or len(names) < 3 or len(set(names)) < len(names):
        raise LatencyReportError(
            f"{path}, row 1: columns {', '.join(names)}; expected {TIME}, {TOUCH} and {ECHO} or {ACCELERATION} or both"
        )
    columns = np.array([_numbers(path, number, names, row) for number, row in enumerate(rows, 2) if row]).T
    if columns.size == 0 or columns.shape[1] < 2 or (np.diff(columns[names.index(TIME)]) <= 0).any():
        raise LatencyReportError(f"{path}: needs two rows or more whose {TIME} rises")
    values = dict(zip(names, columns, strict=True))
    return Capture(path, values[TIME], values[TOUCH], values.get(ECHO), values.get(ACCELERATION))


def _numbers(path: Path, number: int, names: list[str], row: list[str]) -> list[float]:
    if len(row) != len(names):
        raise LatencyReportError(f"{path}, row {number}: {len(row)} values; expected {len(names)}")
    values = []
    for name, text in zip(names, row, strict=True):
        try:
            values.append(float(text))
        except ValueError as error:
            raise LatencyReportError(f"{path}, row {number}, {name}: {text!r} is no number") from error
    return values


def rising_edges(values: Array) -> NDArray[np.int64]:
    """Samples at which a signal of two levels goes up: over 60 % of its range after it was under 40 %."""
    low, high = np.percentile(values, [1, 99])
    is_high, is_low = values > low + 0.6 * (high - low), values < low + 0.4 * (high - low)
    # The last level that was clear, carried over what lies between.
    clear = np.where(is_high | is_low, np.arange(len(values)), 0)
    level = is_high[np.maximum.accumulate(clear)]
    return np.flatnonzero(level[1:] & ~level[:-1]) + 1


def first_exceedance(
    acceleration: Array, start: int, stop: int, threshold: float | None, noise_from: int
) -> int | None:
    """The first sample in start..stop whose acceleration leaves its rest by more than `threshold`.

    Without a threshold: by six times the noise from `noise_from` to `start`.
    """
    before = acceleration[noise_from : start + 1]
    rest = float(np.median(before))
    if threshold is None:
        threshold = _NOISES * _NOISE_OF_DEVIATION * float(np.median(abs(before - rest)))
    beyond = np.flatnonzero(abs(acceleration[start:stop] - rest) > threshold)
    return None if not len(beyond) else start + int(beyond[0])


def delays_of(capture: Capture, threshold: float | None = None) -> dict[str, Values]:
    """Ns from each touch to the echo, from there to the acceleration, and from touch to the last; NaN where none came.

    Raises LatencyReportError for a capture without a touch.
    """
    touches = rising_edges(capture.touch_v)
    if not len(touches):
        raise LatencyReportError(f"{capture.path}: {TOUCH} never rises: is the touch signal connected?")
    stops = np.minimum(np.append(touches[1:], len(capture.time_s)), touches + round(_LONGEST_S / capture.step_s))
    since = capture.time_s[touches]
    ends: dict[str, Array] = {}
    if capture.echo_v is not None:
        edges = rising_edges(capture.echo_v)
        ends["echo"] = np.array([_first(capture, edges, *span) for span in zip(touches, stops, strict=True)])
    if capture.acceleration is not None:
        before = np.append(0, touches[:-1] + (touches[1:] - touches[:-1]) // 2)
        found = [
            first_exceedance(capture.acceleration, int(touch), int(stop), threshold, int(rest))
            for touch, stop, rest in zip(touches, stops, before, strict=True)
        ]
        ends["acceleration"] = np.array([np.nan if i is None else capture.time_s[i] for i in found])
    delays = {f"touch to {name}": _NS_PER_S * (end - since) for name, end in ends.items()}
    if len(ends) == 2:
        delays["echo to acceleration"] = _NS_PER_S * (ends["acceleration"] - ends["echo"])
    return delays


def _first(capture: Capture, edges: NDArray[np.int64], start: int, stop: int) -> float:
    inside = edges[(edges >= start) & (edges < stop)]
    return float(capture.time_s[inside[0]]) if len(inside) else float("nan")


def capture_json(capture: Capture, threshold: float | None = None) -> dict[str, Any]:
    """The document of a report on a capture, without machine and command."""
    delays = delays_of(capture, threshold)
    whole = "touch to acceleration" if capture.acceleration is not None else "touch to echo"
    figures = {name: figures_of(values) for name, values in delays.items()}
    missing = int(np.isnan(delays[whole]).sum())
    return {
        "format": FORMAT,
        "revision": REVISION,
        "whole": whole,
        "simulated": [],
        "method": (
            f"Measured on a capture, {len(delays[whole])} touches, {missing} of them without an answer; samples every "
            f"{1e6 * capture.step_s:g} us: no edge is known better."
        ),
        "floor_note": "",
        "ratios": [],
        "conditions": [
            {
                "name": capture.path.name,
                "engine": "physical",
                "load": "as captured",
                "steps": [],
                "stages": {name: asdict(found) for name, found in figures.items() if found is not None},
                "misses": misses_of(delays[whole]),
                "blame": None,
            }
        ],
    }
