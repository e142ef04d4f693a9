"""Compares two measurements of the same conditions: whether latency got worse, by how much at least, in which stage.

Samples that follow one another share what the machine did at the moment, so the bootstrap draws rounds, and within a
round stretches of neighbours. What the machine did to the C echo engine as well is not counted against the engine.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from operator import sub
from typing import Any

import numpy as np

from tactable.bench.latency.stages import STAGES, Point, Stamps, Values, durations_of

TOLERANCE = 0.05  # a smaller ratio is no change: a shared machine drifts by as much
RESAMPLES = 400  # ten lie beyond either end of the interval
_CONFIDENCE = 0.95  # the custom of the field
_BLOCK = 32  # samples of a stretch
Statistic = Callable[[Values], float]
Rounds = Sequence[Stamps]  # one array of stamps a round


@dataclass(frozen=True)
class Interval:
    """A ratio or difference with its 95 % bootstrap interval; NaN without samples."""

    value: float
    low: float
    high: float


def percentile(values: Values, share: float) -> float:
    """The value that `share` percent of the known values stay within; NaN without one."""
    known = values[np.isfinite(values)]
    return float(np.percentile(known, share, method="inverted_cdf")) if len(known) else float("nan")


def median(values: Values) -> float:
    """Median of the known values; NaN without one."""
    return float(np.nanmedian(values)) if np.isfinite(values).any() else float("nan")


def compare(
    ours: Sequence[Values], theirs: Sequence[Values], statistic: Statistic, combine: Callable[[float, float], float]
) -> Interval:
    """`combine(statistic of ours, statistic of theirs)` with its interval; each argument is one array a round."""
    random = np.random.default_rng(0)
    value = combine(statistic(np.concatenate(ours)), statistic(np.concatenate(theirs)))
    drawn = [combine(statistic(_redraw(ours, random)), statistic(_redraw(theirs, random))) for _ in range(RESAMPLES)]
    tail = 50 * (1 - _CONFIDENCE)
    low, high = np.nanpercentile(drawn, [tail, 100 - tail]) if np.isfinite(drawn).any() else (np.nan, np.nan)
    return Interval(value, float(low), float(high))


def ratio(ours: float, theirs: float) -> float:
    """Ratio of two durations; NaN where the second is 0."""
    return ours / theirs if theirs else float("nan")


def _redraw(rounds: Sequence[Values], random: np.random.Generator) -> Values:
    """Resample the rounds with replacement, and stretches of neighbours within each (block bootstrap)."""
    drawn = []
    for values in (rounds[index] for index in random.integers(len(rounds), size=len(rounds))):
        block = min(_BLOCK, len(values))
        count = -(-len(values) // block) if block else 0
        starts = random.integers(len(values) - block + 1, size=count)
        drawn.append(values[(starts[:, None] + np.arange(block)).ravel()[: len(values)]])
    return np.concatenate(drawn)


def compare_condition(now: Rounds, before: Rounds, floor: float) -> dict[str, Any]:
    """Median and p99 of the way from due to written against a baseline, and the stage that changed most.

    `floor` is the factor by which the C echo engine of the same condition got slower; 1 where it was not measured.
    """
    figures = {}
    for name, statistic in (("median", median), ("p99", partial(percentile, share=99))):
        whole = compare(_column(now, Point.WRITTEN), _column(before, Point.WRITTEN), statistic, ratio)
        figures[name] = {"ratio": whole.value, "low": whole.low, "high": whole.high, "verdict": _verdict(whole, floor)}
    stages = {point: (_stage(now, point), _stage(before, point)) for point in STAGES if point <= Point.WRITTEN}
    changes = {point: sub(*(median(np.concatenate(rounds)) for rounds in pair)) for point, pair in stages.items()}
    known = [point for point in changes if np.isfinite(changes[point])]
    if known:
        point = max(known, key=lambda point: abs(changes[point]))
        change = compare(*stages[point], median, sub)
        figures["stage"] = {
            "name": STAGES[point].name,
            "layer": STAGES[point].layer,
            "median_change_us": change.value / 1e3,
            "low_us": change.low / 1e3,
            "high_us": change.high / 1e3,
        }
    return figures


def _verdict(whole: Interval, floor: float) -> str:
    if whole.low > (1 + TOLERANCE) * max(1.0, floor):
        return "worse"
    if whole.high < (1 - TOLERANCE) * min(1.0, floor):
        return "better"
    return "no difference that these samples tell"


def _column(rounds: Rounds, point: Point) -> list[Values]:
    return [stamps[:, point] for stamps in rounds]


def _stage(rounds: Rounds, point: Point) -> list[Values]:
    return [durations_of(stamps, point) for stamps in rounds]


def compare_runs(
    now: Mapping[str, Rounds], before: Mapping[str, Rounds], floor_of: Mapping[str, str]
) -> dict[str, Any]:
    """Compare every condition that both runs have, by its name; `floor_of` maps a condition to its floor."""
    shared = [name for name in now if name in before and name not in floor_of.values()]
    compared = {}
    for name in shared:
        floor_name, floor = floor_of.get(name), 1.0
        if floor_name is not None and floor_name in now and floor_name in before:
            ours, theirs = (np.concatenate(_column(run[floor_name], Point.WRITTEN)) for run in (now, before))
            floor = ratio(median(ours), median(theirs))
        compared[name] = {**compare_condition(now[name], before[name], floor), "floor_ratio": floor}
    return compared


def got_worse(compared: Mapping[str, Any]) -> list[str]:
    """Names of the conditions that got worse, at the median or in the tail."""
    return [name for name, figures in compared.items() if "worse" in (figures[k]["verdict"] for k in ("median", "p99"))]
