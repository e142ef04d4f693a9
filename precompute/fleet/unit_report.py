"""The report of one serial number: a page with the verdict, the values that were judged, and the table's figures."""

from engine.device.quantity import interval_text, quantity_text
from precompute.fleet.summary import Summary
from precompute.fleet.units import Outcome
from precompute.fleet.verdict import Limits, limit_of

REPORT = "report.md"


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
