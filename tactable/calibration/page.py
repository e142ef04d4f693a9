"""A calibration and a plan of measurements for people to read."""

from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Column
from rich.table import Table as Grid

from engine.device.quantity import interval_text, quantity_text
from precompute.calibration.report import drive_text, open_text


def print_calibration(out: Console, report: dict[str, Any], folder: str, doubts: Sequence[str]) -> None:
    """Values, what is open, where it was written, and why not to trust it."""
    marked = " SIMULATED" if report["simulated"] else ""
    wrong = len(report["wrong_readings"])
    misfit = f"typical misfit {100 * report['median_misfit']:.3g} %, {wrong} taken for wrong"
    _say(out, f"{report['device']}{marked}: {report['readings']} readings, {misfit}")
    grid = Grid(*(Column(title, no_wrap=True) for title in ("parameter", "before", "fitted", "95 % interval")))
    for p in report["parameters"]:
        before, value = quantity_text(p["before"], p["unit"]), quantity_text(p["value"], p["unit"], 5)
        grid.add_row(escape(p["name"]), before, value, interval_text(p["interval"], p["unit"]))
    out.print(grid)
    _say(out, open_text(report))
    _say(out, f"written: {folder}: device file, data, report.md, report.json and fit.png")
    for doubt in doubts:
        _say(out, f"DOUBTFUL: {doubt}")


def print_plan(out: Console, plan: dict[str, Any]) -> None:
    """One line a reading; what it does to the standard errors, as a whole at the end."""
    if plan["readings"]:
        grid = Grid("", "drive", "sensor at", "shrinks most")
        for number, step in enumerate(plan["readings"], 1):
            best = max(step["shrinks"], key=lambda name: step["shrinks"][name])
            shrinks = f"{escape(best)} by {100 * step['shrinks'][best]:.2g} %"
            grid.add_row(str(number), drive_text(step["drive_hz"]), f"{1e3 * step['position_m']:.1f} mm", shrinks)
        out.print(grid)
    grid = Grid("parameter", "value", "standard error", "after these")
    for p in plan["parameters"]:
        before, after = (quantity_text(p[key], p["unit"], 2) for key in ("standard_error", "standard_error_after"))
        grid.add_row(escape(p["name"]), quantity_text(p["value"], p["unit"]), before, after)
    out.print(grid)


def _say(out: Console, text: str) -> None:
    out.print(text, markup=False, highlight=False, soft_wrap=True)
