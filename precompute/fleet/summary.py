"""Summary of a fleet: a row and a verdict for each unit, the figures that vary, the outliers, a page for each unit."""

import csv
import io
import re
import statistics
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

from scipy.stats import spearmanr, theilslopes

from base.plain import to_plain
from engine.device.quantity import interval_text, quantity_text
from engine.device.values import Value, number_of
from precompute.fleet.units import Outcome, Unit
from precompute.fleet.verdict import (
    FEWEST,
    Judgement,
    Limits,
    LotValue,
    Verdict,
    judge,
    limit_of,
    lot_value,
    lot_values,
)

OUTLYING = 3.5
"""Robust standard deviations from the median beyond which a unit is an outlier (Iglewicz and Hoaglin, 1993)."""
_NO_OUTLIERS = re.compile(r"uncertainty\.|.*damping")
"""Columns that vary by factors between good bars, and are at times not told by their readings."""
_TOLD = ("name", "error", "seconds", "fingerprint", "figures")  # of each outcome
_UNLIKELY = 0.005  # probability below which a drift is told: one in 200 values without a drift shows one by chance
REPORT = "report.md"


@dataclass(frozen=True)
class Column:
    """A number that varies over the fleet: its median, its spread (a robust standard deviation) and its extremes.

    drift: its change from the first to the last unit, in the order given; None where chance explains it, or it was
    chosen.
    """

    name: str
    median: float
    spread: float
    least: float
    least_unit: str
    greatest: float
    greatest_unit: str
    drift: float | None = None


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
    verdicts: Mapping[str, Verdict] = field(default_factory=dict)  # of the units that were measured, by name
    lot: Mapping[str, LotValue] = field(default_factory=dict)  # the fitted values that the lot tells, by name

    @property
    def counts(self) -> dict[str, int]:
        """How many units have each judgement, by its word."""
        found = Counter(verdict.judgement for verdict in self.verdicts.values())
        return {judgement.value: found[judgement] for judgement in Judgement}

    @property
    def is_passed(self) -> bool:
        """Whether no unit failed, and every one that was measured passed."""
        return not self.failed and all(verdict.judgement is Judgement.PASS for verdict in self.verdicts.values())

    @property
    def takt_s(self) -> float | None:
        """Median time that a unit took to calibrate, build and verify; None where every one was kept or failed."""
        seconds = [each.seconds for each in self.outcomes if status_of(each) == "built"]
        return statistics.median(seconds) if seconds else None

    @property
    def failed(self) -> list[Outcome]:
        """Outcomes with an error."""
        return [outcome for outcome in self.outcomes if outcome.error is not None]


def summarise(units: Sequence[Unit], outcomes: Sequence[Outcome], limits: Limits = MappingProxyType({})) -> Summary:
    """Summarise a fleet and judge its measured units by the limits.

    A value that was chosen for a unit is not searched for outliers.
    """
    good = [outcome for outcome in outcomes if outcome.error is None]
    numbers = {outcome.name: _numbers(outcome) for outcome in good}
    chosen = {key for unit in units for key in unit.values}
    columns, outliers = list[Column](), list[Outlier]()
    for name in dict.fromkeys(key for row in numbers.values() for key in row):
        values = {unit: row[name] for unit, row in numbers.items() if name in row}
        if len(set(values.values())) < 2:
            continue
        column, is_lot = _column(name, values), len(values) >= FEWEST and not _is_chosen(name, chosen)
        columns.append(replace(column, drift=_drift(list(values.values()))) if is_lot else column)
        if is_lot and not _NO_OUTLIERS.match(name):
            spread = LotValue(column.median, column.spread).judged_spread
            deviations = ((unit, value, (value - column.median) / spread) for unit, value in values.items())
            outliers += [Outlier(unit, name, value, d) for unit, value, d in deviations if abs(d) > OUTLYING]
    lot = lot_values(good)
    measured = {unit.name for unit in units if unit.measurements is not None}
    verdicts = {each.name: judge(each, limits, lot) for each in outcomes if each.name in measured}
    by_deviation = sorted(outliers, key=lambda outlier: -abs(outlier.deviation))
    return Summary(tuple(outcomes), tuple(columns), tuple(by_deviation), verdicts, lot)


def _drift(values: Sequence[float]) -> float | None:
    """Theil and Sen's slope times the number of steps; None where Spearman's test finds none."""
    order = range(len(values))
    if spearmanr(order, values).pvalue >= _UNLIKELY:
        return None
    return float(theilslopes(values, order)[0]) * (len(values) - 1)


def _numbers(outcome: Outcome) -> dict[str, float]:
    every: dict[str, Value] = {**outcome.values, **outcome.figures}
    return {key: number for key, value in every.items() if (number := number_of(value)) is not None}


def _is_chosen(column: str, keys: set[str]) -> bool:
    """Whether one of the keys, such as actuator.stiffness, sets the column, such as actuator[1].stiffness_n_per_m."""
    names = {column, re.sub(r"\[\d+\]", "", column)}
    return any(name == key or name.startswith(f"{key}_") for name in names for key in keys)


def _column(name: str, values: Mapping[str, float]) -> Column:
    middle = lot_value(list(values.values()))
    least, greatest = min(values, key=values.__getitem__), max(values, key=values.__getitem__)
    return Column(
        name=name,
        median=middle.median,
        spread=middle.spread,
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
    writer.writerow(["name", "status", "error", "verdict", "reasons", "seconds", "fingerprint", *names])
    for outcome in summary.outcomes:
        verdict = summary.verdicts.get(outcome.name)
        numbers = {**outcome.values, **outcome.figures}
        writer.writerow(
            [
                outcome.name,
                status_of(outcome),
                outcome.error or "",
                verdict.judgement.value if verdict else "",
                "; ".join(verdict.reasons) if verdict else "",
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
                "verdict": to_plain(summary.verdicts.get(outcome.name)),
                "status": status_of(outcome),
                "values": {key: value for key, value in outcome.values.items() if key in names},
            }
            for outcome in summary.outcomes
        ],
        "columns": to_plain(summary.columns),
        "outliers": to_plain(summary.outliers),
        "failed": len(summary.failed),
        "verdicts": summary.counts,
        "takt_s": summary.takt_s,
    }


def unit_report(outcome: Outcome, summary: Summary, limits: Limits) -> str:
    """The page of one measured unit, in Markdown."""
    verdict, report = summary.verdicts[outcome.name], outcome.report
    parts = [f"# {outcome.name}: {verdict.judgement.value}", "", *(f"- {reason}" for reason in verdict.reasons)]
    if report:
        parts += [
            "",
            f"{report['readings']} readings, typical misfit {100 * report['median_misfit']:.2g} %, "
            f"noise of a reading {100 * report['noise']:.2g} %.",
            "",
            "| value | fitted | 95 % interval | is | the lot's median and spread | limits |",
            "|---|---|---|---|---|---|",
            *_rows(outcome, summary, limits),
        ]
    if outcome.figures:
        parts += ["", "| figure of its table | value |", "|---|---|"]
        parts += [f"| {key} | {'none' if each is None else f'{each:.4g}'} |" for key, each in outcome.figures.items()]
    counts = ", ".join(f"{count} {word}" for word, count in summary.counts.items())
    return "\n".join([*parts, "", f"The lot of {len(summary.outcomes)} units: {counts}."]) + "\n"


def _rows(outcome: Outcome, summary: Summary, limits: Limits) -> list[str]:
    rows = []
    for each in outcome.report["parameters"]:
        name, unit = each["name"], each["unit"]
        lot, stated = summary.lot.get(name), limit_of(name, limits)
        cells = (
            name,
            quantity_text(each["value"], unit),
            interval_text(each["interval"], unit),
            each["known"],
            f"{quantity_text(lot.median, unit)}, {quantity_text(lot.spread, unit, 2)}" if lot else "",
            interval_text(stated, unit) if stated else "",
        )
        rows.append(f"| {' | '.join(cells)} |")
    return rows
