"""Pages about a calibration: the fitted values, the table it was applied to, a plan of measurements."""

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Column
from rich.table import Table as Grid

from engine.device.quantity import interval_text, quantity_text
from precompute.calibration.calibration_report import open_text, place_text
from tactable.calibration.job import times_text
from tactable.explain.words import print_lines

if TYPE_CHECKING:
    from tactable.calibration.apply import Applied


def print_calibration(out: Console, report: dict[str, Any], folder: str, doubts: Sequence[str]) -> None:
    """Print the fitted values, what remains uncertain, the folder, and the reasons to doubt the result."""
    say, marked = partial(print_lines, out), " SIMULATED" if report["simulated"] else ""
    wrong = len(report["wrong_readings"])
    misfit = f"typical misfit {100 * report['median_misfit']:.3g} %, {wrong} readings taken for wrong"
    say(f"{report['device']}{marked}: {report['readings']} readings, {misfit}")
    grid = Grid(*(Column(title, no_wrap=True) for title in ("parameter", "before", "fitted", "95 % interval")))
    for p in report["parameters"]:
        before, value = quantity_text(p["before"], p["unit"]), quantity_text(p["value"], p["unit"], 5)
        grid.add_row(p["name"], before, value, interval_text(p["interval"], p["unit"]))
    out.print(grid)
    say(open_text(report))
    say(f"written: {folder}: device file, data, report.md, report.json and fit.png")
    if (flash := report.get("flash")) and not doubts:
        say(f"flash the board with {flash}: HELLO then says the fitted full scale, and runs compare with that")
        say(f"a sound card has nothing to flash: give its --port {report['card']}")
    for doubt in doubts:
        say(f"DOUBTFUL: {doubt}")


def print_applied(out: Console, table: Path, applied: "Applied") -> None:
    """Print whether the table was put in place, and how long each step took."""
    say = partial(print_lines, out)
    if applied.is_refused:
        say(f"{table}: left as it was, because the fit is doubtful; --despite-doubts applies it all the same")
    elif applied.in_place_after_s is None:
        say(f"{table}: was put in place before")
    else:
        say(f"{table}: in place {applied.in_place_after_s:.1f} s after the start; a run that plays it changes over")
        say(f"  {times_text(applied.seconds)}")


def print_clicks(out: Console, table: Path, is_complete: bool, clicks_s: float | None) -> None:
    """Print what became of the clicks of two fingers; `clicks_s`: the time to add them; is_complete: there before."""
    say = partial(print_lines, out)
    if clicks_s is not None:
        say(f"{table}: clicks of two fingers added in {clicks_s:.0f} s and put in place in a second change")
    elif not is_complete:
        say(f"{table}: has the clicks of one finger; a run solves the others, without --no-clicks they are added")
    say(f"back to the previous table: tactable rollback {table}")


def print_plan(out: Console, plan: dict[str, Any]) -> None:
    """Print a line for each proposed reading, then what all of them do to the standard errors."""
    if plan["readings"]:
        grid = Grid("", "drive", "sensor at", "shrinks most")
        for number, step in enumerate(plan["readings"], 1):
            best = max(step["shrinks"], key=lambda name: step["shrinks"][name])
            shrinks = f"{best} by {100 * step['shrinks'][best]:.2g} %"
            grid.add_row(str(number), _drive_text(step["drive_hz"]), place_text(step["position_m"]), shrinks)
        out.print(grid)
    grid = Grid("parameter", "value", "standard error", "after these")
    for p in plan["parameters"]:
        before, after = (quantity_text(p[key], p["unit"], 2) for key in ("standard_error", "standard_error_after"))
        grid.add_row(p["name"], quantity_text(p["value"], p["unit"]), before, after)
    out.print(grid)


def _drive_text(drive_hz: Sequence[float | None]) -> str:
    """The drive in words, such as "150 Hz and still", in the order of the actuators."""
    return " and ".join("still" if hz is None or math.isnan(hz) else f"{hz:g} Hz" for hz in drive_hz)
