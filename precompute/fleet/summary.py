"""Outcomes to a summary: a row a unit, what varies over the fleet, and the units that stand out."""

import csv
import io
import re
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from engine.device.values import Value, number_of
from precompute.fleet.units import Outcome, Unit

OUTLYING = 3.5
"""Robust standard deviations from the median beyond which a unit stands out (Iglewicz and Hoaglin, 1993)."""
FEWEST = 8
"""Of fewer units none stands out."""
_NORMAL_MAD = 1.4826  # standard deviation of normal noise over its median absolute deviation
_LEAST_SPREAD = 1e-6  # of the median: rounding is no spread


@dataclass(frozen=True)
class Column:
    """A number that varies over the fleet: its middle, its spread (a robust standard deviation), and its extremes."""

    name: str
    median: float
    spread: float
    least: float
    least_unit: str
    greatest: float
    greatest_unit: str


@dataclass(frozen=True)
class Outlier:
    """A unit that stands out in one column, by so many spreads."""

    unit: str
    column: str
    value: float
    deviation: float


@dataclass(frozen=True)
class Summary:
    """Of a fleet: outcomes in the order of the units, columns, and outliers, the farthest first."""

    outcomes: tuple[Outcome, ...]
    columns: tuple[Column, ...]
    outliers: tuple[Outlier, ...]

    @property
    def failed(self) -> list[Outcome]:
        """Those with an error."""
        return [outcome for outcome in self.outcomes if outcome.error is not None]


def summarise(units: Sequence[Unit], outcomes: Sequence[Outcome]) -> Summary:
    """What was chosen to vary is no outlier."""
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
    """Whether actuator[1].stiffness_n_per_m is what a key such as actuator[1].stiffness or actuator.stiffness says."""
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
    """A row a unit; the columns that vary."""
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
    """In a word."""
    return "failed" if outcome.error is not None else "kept" if outcome.is_kept else "built"


def summary_json(summary: Summary) -> dict[str, Any]:
    """Everything as plain values."""
    names = [column.name for column in summary.columns]
    return {
        "units": [
            {
                "name": outcome.name,
                "status": status_of(outcome),
                "error": outcome.error,
                "doubts": outcome.doubts,
                "seconds": outcome.seconds,
                "fingerprint": outcome.fingerprint,
                "values": {key: value for key, value in outcome.values.items() if key in names},
                "figures": outcome.figures,
            }
            for outcome in summary.outcomes
        ],
        "columns": [vars(column) for column in summary.columns],
        "outliers": [vars(outlier) for outlier in summary.outliers],
        "failed": len(summary.failed),
    }
