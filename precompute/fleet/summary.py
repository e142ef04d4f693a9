"""Summary of a fleet: a row for each unit, the figures that vary, and the outliers."""

import csv
import io
import re
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from base.plain import to_plain
from engine.device.values import Value, number_of
from precompute.fleet.units import Outcome, Unit

OUTLYING = 3.5
"""Robust standard deviations from the median beyond which a unit is an outlier (Iglewicz and Hoaglin, 1993)."""
FEWEST = 8
"""Fewest units for which outliers are sought."""
_NORMAL_MAD = 1.4826  # standard deviation of normal noise over its median absolute deviation
_TOLD = ("name", "error", "doubts", "seconds", "fingerprint", "figures")  # of each outcome
_LEAST_SPREAD = 1e-6  # of the median: below it differences are rounding errors


@dataclass(frozen=True)
class Column:
    """A number that varies over the fleet: its median, its spread (a robust standard deviation) and its extremes."""

    name: str
    median: float
    spread: float
    least: float
    least_unit: str
    greatest: float
    greatest_unit: str


@dataclass(frozen=True)
class Outlier:
    """A unit that is an outlier in one column; `deviation` is in spreads."""

    unit: str
    column: str
    value: float
    deviation: float


@dataclass(frozen=True)
class Summary:
    """Outcomes in the order of the units, columns, and outliers with the farthest first."""

    outcomes: tuple[Outcome, ...]
    columns: tuple[Column, ...]
    outliers: tuple[Outlier, ...]

    @property
    def failed(self) -> list[Outcome]:
        """Outcomes with an error."""
        return [outcome for outcome in self.outcomes if outcome.error is not None]


def summarise(units: Sequence[Unit], outcomes: Sequence[Outcome]) -> Summary:
    """Summarise a fleet; a value that was chosen for a unit is not searched for outliers."""
    good = [outcome for outcome in outcomes if outcome.error is None]
    numbers = {outcome.name: _numbers(outcome) for outcome in good}
    chosen = {key for unit in units for key in unit.values}
    columns, outliers = list[Column](), list[Outlier]()
    for name in dict.fromkeys(key for row in numbers.values() for key in row):
        values = {unit: row[name] for unit, row in numbers.items() if name in row}
        if len(set(values.values())) < 2:
            continue
        column = _column(name, values)
        columns.append(column)
        if len(values) >= FEWEST and not _is_chosen(name, chosen):
            deviations = ((unit, value, (value - column.median) / column.spread) for unit, value in values.items())
            outliers += [Outlier(unit, name, value, d) for unit, value, d in deviations if abs(d) > OUTLYING]
    return Summary(tuple(outcomes), tuple(columns), tuple(sorted(outliers, key=lambda o: -abs(o.deviation))))


def _numbers(outcome: Outcome) -> dict[str, float]:
    every: dict[str, Value] = {**outcome.values, **outcome.figures}
    return {key: number for key, value in every.items() if (number := number_of(value)) is not None}


def _is_chosen(column: str, keys: set[str]) -> bool:
    """Whether one of the keys, such as actuator.stiffness, sets the column, such as actuator[1].stiffness_n_per_m."""
    names = {column, re.sub(r"\[\d+\]", "", column)}
    return any(name == key or name.startswith(f"{key}_") for name in names for key in keys)


def _column(name: str, values: Mapping[str, float]) -> Column:
    median = statistics.median(values.values())
    spread = _NORMAL_MAD * statistics.median(abs(value - median) for value in values.values())
    least, greatest = min(values, key=values.__getitem__), max(values, key=values.__getitem__)
    return Column(
        name=name,
        median=median,
        spread=max(spread, _LEAST_SPREAD * abs(median)) or _LEAST_SPREAD,
        least=values[least],
        least_unit=least,
        greatest=values[greatest],
        greatest_unit=greatest,
    )


def summary_csv(summary: Summary) -> str:
    """CSV text with a row for each unit and the columns that vary."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    names = [column.name for column in summary.columns]
    writer.writerow(["name", "status", "error", "doubts", "seconds", "fingerprint", *names])
    for outcome in summary.outcomes:
        numbers = {**outcome.values, **outcome.figures}
        writer.writerow(
            [
                outcome.name,
                status_of(outcome),
                outcome.error or "",
                "; ".join(outcome.doubts),
                f"{outcome.seconds:.3f}",
                outcome.fingerprint,
                *(numbers.get(name, "") for name in names),
            ]
        )
    return out.getvalue()


def status_of(outcome: Outcome) -> str:
    """The status in a word."""
    return "failed" if outcome.error is not None else "kept" if outcome.is_kept else "built"


def summary_json(summary: Summary) -> dict[str, Any]:
    """The summary as plain values for JSON."""
    names = [column.name for column in summary.columns]
    return {
        "units": [
            {
                **{key: getattr(outcome, key) for key in _TOLD},
                "status": status_of(outcome),
                "values": {key: value for key, value in outcome.values.items() if key in names},
            }
            for outcome in summary.outcomes
        ],
        "columns": to_plain(summary.columns),
        "outliers": to_plain(summary.outliers),
        "failed": len(summary.failed),
    }
