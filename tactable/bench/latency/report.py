"""Measured segments to the document of a report: versioned, for machines, with all that a reader must know."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from firmware_link.protocol.errors import TactableError
from tactable.bench.latency.compare import compare, median, percentile, ratio
from tactable.bench.latency.plan import Plan
from tactable.bench.latency.run import Condition, Measured
from tactable.bench.latency.stages import STAGES, Point, Stamps, Values, blame, stages_json

FORMAT, REVISION = "tactable latency", 1
_SUMMED = (
    "reports_sent",
    "reports_lost",
    "commands",
    "answered_by_fast_path",
    "mispredicted",
    "replaced_unsent",
    "stale_sent",
    "sessions_lost",
    "released_by_watchdog",
)


class LatencyReportError(TactableError, ValueError):
    """A report that cannot be used as a baseline: which, and why."""


@dataclass(frozen=True)
class Run:
    """All segments of a measurement, by condition, in the order of their rounds."""

    plan: Plan
    measured: Mapping[Condition, Sequence[Measured]]

    def rounds(self) -> dict[str, list[Stamps]]:
        """Stamps by the name of their condition."""
        return {condition.name: [part.stamps for part in parts] for condition, parts in self.measured.items()}


def run_json(run: Run) -> dict[str, Any]:
    """Conditions, the ratios to their floors, and the layers that cost most."""
    return {
        "format": FORMAT,
        "revision": REVISION,
        "whole": "due to written",
        "stages": {stage.name: {"layer": stage.layer, "meaning": stage.meaning} for stage in STAGES.values()},
        "conditions": [_condition_json(condition, parts) for condition, parts in run.measured.items()],
        "ratios": _ratios(run),
    }


def _condition_json(condition: Condition, parts: Sequence[Measured]) -> dict[str, Any]:
    stamps = np.concatenate([part.stamps for part in parts])
    facts: dict[str, Any] = {key: sum(part.facts[key] for part in parts) for key in _SUMMED if key in parts[0].facts}
    if "order_kept" in parts[0].facts:
        kept = [part.facts["order_kept"] for part in parts]
        facts["order_kept"] = False if False in kept else None if None in kept else True
        facts["clock_bounds_us"] = max(part.facts["clock_bounds_us"] for part in parts)
    return {
        "name": condition.name,
        "engine": condition.engine,
        "rate_hz": condition.rate_hz,
        "load": str(condition.load),
        "steps": [{**asdict(outcome), "in_force": outcome.in_force} for outcome in parts[0].outcomes],
        "steps_asked": condition.steps_text,
        "rounds": len(parts),
        **facts,
        **stages_json(stamps),
        "blame": blame(stamps),
    }


def _ratios(run: Run) -> list[dict[str, Any]]:
    """Each condition against its floor in the same run: the way from due, and from sent, to written."""
    rows = []
    for condition, parts in run.measured.items():
        floor = run.plan.floor_of(condition)
        if floor is None or floor not in run.measured:
            continue
        for since in (Point.DUE, Point.SENT):
            ours = [_way(part.stamps, since) for part in parts]
            theirs = [_way(part.stamps, since) for part in run.measured[floor]]
            way = f"{since.name.lower()} to written"
            row: dict[str, Any] = {"condition": condition.name, "against": floor.engine, "way": way}
            enough = min(sum(map(len, ours)), sum(map(len, theirs))) >= 10_000
            for name, statistic, is_told in (("median", median, True), ("p99_9", percentile(99.9), enough)):
                found = compare(ours, theirs, statistic, ratio)
                row[name] = asdict(found) if is_told and math.isfinite(found.value) else None
            rows.append(row)
    return rows


def _way(stamps: Stamps, since: Point) -> Values:
    way: Values = stamps[:, Point.WRITTEN] - stamps[:, since]
    return way


# ---- raw samples -----------------------------------------------------------------------------------------


def write_samples(run: Run, path: Path) -> None:
    """Every stamp, by condition and round: `NAME/ROUND` is (sample, point) in ns after `NAME/ROUND/due` (sample,)."""
    arrays: dict[str, Any] = {"points": np.array([point.name for point in Point])}
    for condition, parts in run.measured.items():
        for number, part in enumerate(parts):
            arrays[f"{condition.name}/{number}"] = part.stamps
            arrays[f"{condition.name}/{number}/due"] = part.due_ns
    np.savez_compressed(path, **arrays)


def read_samples(path: Path) -> dict[str, list[Stamps]]:
    """Stamps of each condition by its name, a part a round. Raises LatencyReportError for a file that is none."""
    rounds: dict[str, list[Stamps]] = {}
    try:
        with np.load(path) as arrays:
            if [str(name) for name in arrays["points"]] != [point.name for point in Point]:
                raise LatencyReportError(f"{path}: its points are others than ours: measure the baseline again")
            for key in arrays.files:
                name, _, number = key.rpartition("/")
                if number.isdecimal():
                    rounds.setdefault(name, []).append(arrays[key])
    except (OSError, KeyError, ValueError) as error:
        if isinstance(error, LatencyReportError):
            raise
        raise LatencyReportError(f"{path}: holds no samples of ours ({error}); it lies beside its report") from error
    return rounds
