"""A calibration as it was asked for: fitted and written to a folder, or found there from an earlier run.

The folder holds the new device file, the raw measurements, the report and a picture of the fit. It appears whole or
not at all, and its report keeps everything that decided the result, so that the same job finds it again. What is
printed about it stands at the end of this module.
"""

import hashlib
import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Column
from rich.table import Table as Grid

from base.files import check_new_folder, write_new_folder
from engine.device import Device
from engine.device.quantity import interval_text, quantity_text
from engine.render.board_fit import card_text, flash_text
from precompute.calibration.adequacy import doubts_of
from precompute.calibration.calibration_report import open_text, place_text
from precompute.calibration.fitted import REPORT, Fitted, calibrated_device, fit_file
from precompute.measurements.parameters import Bounds
from tactable.explain.words import print_lines

Progress = Callable[[str, float], None]


class StepTimes:
    """Seconds by step, from its creation on; a step ends when another one is reported."""

    def __init__(self, show: Progress, step: str, clock_s: Callable[[], float] = time.perf_counter) -> None:
        self._show, self._step, self._clock_s = show, step, clock_s
        self._start_s = self._since_s = clock_s()
        self._seconds: dict[str, float] = {}

    def tell_step(self, step: str, fraction: float) -> None:
        """Report the present step and the fraction done, and pass both on."""
        self._show(step, fraction)
        if step != self._step:
            self._end_step()
            self._step = step

    def read(self) -> dict[str, float]:
        """Seconds of every step so far, the present one included, in the order of their beginning."""
        self._end_step()
        return dict(self._seconds)

    @property
    def total_s(self) -> float:
        """Seconds since its creation."""
        return self._clock_s() - self._start_s

    def _end_step(self) -> None:
        now_s = self._clock_s()
        self._seconds[self._step] = self._seconds.get(self._step, 0.0) + now_s - self._since_s
        self._since_s = now_s


def times_text(seconds: dict[str, float]) -> str:
    """The times in words, such as "fit 0.7 s, sweep 0.9 s"; steps of no time are left out."""
    return ", ".join(f"{step} {value:.2g} s" for step, value in seconds.items() if value >= 0.01)


@dataclass(frozen=True)
class CalibrationJob:
    """All that decides a calibration; `bounds` in SI units."""

    device: Device
    measurements: Path
    folder: Path
    names: tuple[str, ...]
    bounds: Mapping[str, Bounds]
    sensor_mass_kg: float
    starts: int
    seed: int
    accepted_misfit: float
    is_strict: bool  # a parameter that is not known within a factor of 2 makes the result doubtful
    is_modes: bool = False  # the measurements are modes

    @property
    def device_file(self) -> Path:
        """File of the calibrated device."""
        return self.folder / f"{self.device.name}.toml"

    def fit(self, progress: Progress) -> Fitted:
        """Read the measurements and fit. Raises CalibrationError, FolderError where the folder is there already."""
        check_new_folder(self.folder)
        progress("fit", 0.0)
        fitted = fit_file(
            self.device,
            self.measurements,
            self.names,
            sensor_mass_kg=self.sensor_mass_kg,
            created=datetime.now(UTC).isoformat(timespec="seconds"),
            bounds=self.bounds,
            starts=self.starts,
            seed=self.seed,
            is_modes=self.is_modes,
        )
        report = fitted.report | {"asked": self._asked(fitted.raw)}
        if any(p["name"].endswith("full_scale") for p in report["parameters"]):
            device = calibrated_device(fitted.calibration)
            report |= {"flash": flash_text(device), "card": card_text(device)}
        return replace(fitted, report=report)

    def write(self, fitted: Fitted) -> None:
        """Write the folder. Raises FolderError."""
        from tactable.figures.calibration import calibration_png  # takes a second to import, which a refusal need not

        write_new_folder(self.folder, fitted.files() | {"fit.png": calibration_png(fitted.calibration)})

    def doubts_of(self, report: Mapping[str, Any]) -> list[str]:
        """Reasons not to use the result without a look."""
        return doubts_of(report, self.accepted_misfit, is_strict=self.is_strict)

    def kept_report(self) -> dict[str, Any] | None:
        """Report of an earlier run of the same job; None where the folder holds none, or that of another job."""
        try:
            report: dict[str, Any] = json.loads((self.folder / REPORT).read_text(encoding="utf-8"))
            raw = self.measurements.read_bytes()
        except (OSError, ValueError):
            return None
        return report if report.get("asked") == self._asked(raw) and self.device_file.is_file() else None

    def _asked(self, raw: bytes) -> dict[str, Any]:
        """Values that decide the result, for JSON."""
        return {
            "device_sha256": hashlib.sha256(self.device.text.encode()).hexdigest(),
            "measurements_sha256": hashlib.sha256(raw).hexdigest(),
            "names": list(self.names),
            "bounds": {name: list(ends) for name, ends in self.bounds.items()},
            "sensor_mass_kg": self.sensor_mass_kg,
            "starts": self.starts,
            "seed": self.seed,
            **({"is_modes": True} if self.is_modes else {}),
        }


def calibration_json(job: CalibrationJob, report: Mapping[str, Any], doubts: Sequence[str]) -> dict[str, Any]:
    """Calibration as plain values: files, doubts and the report."""
    return {"folder": str(job.folder), "device_file": str(job.device_file), "doubts": list(doubts), **report}


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
