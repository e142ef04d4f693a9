"""A calibration to the table that a run plays: built, verified, put in place; clicks follow in a second change."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rich.console import Console

from engine.device import Device
from engine.table import Table, TableError
from engine.table.diff import TableDiff, compare_tables
from engine.table.history import previous_of
from precompute.builder.build import build_table
from precompute.builder.code_fingerprint import code_fingerprint
from precompute.builder.incremental import BuildOptions, is_compatible, is_current, outdated_parts
from precompute.entries.solver import prepare_entries
from precompute.parallel.pool import WorkerPool, available_cores
from tactable.calibration.job import CalibrationJob, Fitted, calibration_json
from tactable.calibration.page import print_calibration
from tactable.cli.diff import print_short_diff, short_diff_json
from tactable.progress import shown_progress
from tactable.step_times import StepTimes, times_text


@dataclass(frozen=True)
class ApplyOptions:
    """What was asked for beside the calibration."""

    table: Path
    despite_doubts: bool
    with_clicks: bool
    as_json: bool


@dataclass(frozen=True)
class InPlace:
    """A table that took its place `after_s` the start, and how long each step took; None: it was there before."""

    after_s: float | None
    seconds: dict[str, float]


class TableTarget:
    """The table that a calibration is to be applied to, looked at before anything is fitted.

    Raises TableError where there is none, where it is of another bar, and where a calibration cannot make it.
    """

    def __init__(self, path: Path, device: Device) -> None:
        self.path = path
        with Table.open(path) as table:
            if table.device.name != device.name or not is_compatible(table.device, device):
                asked = f"{device.name!r} with its zones, actuators and limits"
                raise TableError(f"{path}: is of {table.device.name!r}, not of {asked}; name the table of this bar")
            self._options = replace(BuildOptions.of(table), code_fingerprint=code_fingerprint())
        if self._options.responses_sha256:
            raise TableError(
                f"{path}: was built from measured responses, which a calibration does not change; measure them again "
                "and build it with --responses"
            )

    def put_in_place(self, device: Device, times: StepTimes, pool: WorkerPool) -> InPlace:
        """Build the table anew for `device` as it was built before, its clicks as they were. Raises TableError."""
        with Table.open(self.path, verify=False) as table:
            if is_current(table, device, self._options):
                return InPlace(None, {})
        self._build(device, times, pool, clicks_later=True)
        return InPlace(times.total_s, times.read())

    def complete(self, device: Device, times: StepTimes, pool: WorkerPool) -> None:
        """Make what is outdated in it. Raises TableError."""
        self._build(device, times, pool, clicks_later=False)

    def outdated(self) -> str:
        """What it has of the bar before, in words; empty: nothing."""
        with Table.open(self.path, verify=False) as table:
            return " and ".join(outdated_parts(table))

    def diff(self) -> TableDiff | None:
        """What is different from the table before, where that is kept."""
        before = previous_of(self.path)
        if not before.is_file():
            return None
        with Table.open(before, verify=False) as own, Table.open(self.path, verify=False) as other:
            return compare_tables(own, other)

    def _build(self, device: Device, times: StepTimes, pool: WorkerPool, *, clicks_later: bool) -> None:
        build_table(
            device,
            self.path,
            objective=self._options.objective,
            made_for=self._options.made_for,
            clicks_up_to=self._options.clicks_up_to,
            click_options=self._options.click_options,
            workers=available_cores(),
            pool=pool,
            clicks_later=clicks_later,
            completes=not clicks_later,
            progress=times.tell,
        )


def apply_calibration(
    out: Console, job: CalibrationJob, doubts_of: Callable[[dict[str, Any]], list[str]], options: ApplyOptions
) -> list[str]:
    """Calibrate, build, put in place, and say so; what is done already is not done again.

    The doubts for which the table was left as it was. Raises what its parts raise.
    """
    with _waiting_pool() as pool, shown_progress(options.as_json) as show:
        times = StepTimes(show, "start")
        target = TableTarget(options.table, job.device)
        found = _find(job, times)
        doubts = doubts_of(found.report)
        refused = [] if options.despite_doubts else doubts
        placed = None if refused else target.put_in_place(found.device, times, pool)
        times.tell("report", 1.0)
        if found.fitted is not None:  # only now: the picture takes as long as the fit
            job.write(found.fitted)
    if not options.as_json:
        print_calibration(out, found.report, str(job.folder), doubts)
        _print_placed(out, target, placed)
    said = {} if placed is None else _follow_up(out, target, found.device, placed, options)
    if options.as_json:
        document = {**calibration_json(job, found.report, doubts), "applied": {"table": str(target.path), **said}}
        print(json.dumps(document, indent=2))  # noqa: T201  # JSON goes out as it is, without a terminal's width
    return refused


@dataclass(frozen=True)
class _Found:
    """A calibrated device with its report; `fitted` where that is not written yet."""

    report: dict[str, Any]
    device: Device
    fitted: Fitted | None


def _find(job: CalibrationJob, times: StepTimes) -> _Found:
    """What was found by the same command before, or now."""
    kept = job.kept_report()
    if kept is not None:
        return _Found(kept, Device.read(job.device_file), None)
    fitted = job.fit(times.tell)
    return _Found(fitted.report, fitted.device(str(job.device_file)), fitted)


def _follow_up(
    out: Console, target: TableTarget, device: Device, placed: InPlace, options: ApplyOptions
) -> dict[str, Any]:
    """What changed, then the clicks; the same for machines."""
    diff, outdated, clicks_s = target.diff(), target.outdated(), None
    if diff is not None and not options.as_json:
        print_short_diff(out, diff)
        _say(out, f"all of it: tactable diff {previous_of(target.path)} {target.path}")
    if outdated and options.with_clicks:
        with WorkerPool(0) as nobody, shown_progress(options.as_json) as show:
            times = StepTimes(show, "clicks")
            target.complete(device, times, nobody)
        clicks_s = times.total_s
    if not options.as_json:
        _print_clicks(out, target, outdated, clicks_s)
    return {
        "in_place_after_s": placed.after_s,
        "seconds": placed.seconds,
        "clicks_s": clicks_s,
        "outdated": "" if options.with_clicks else outdated,
        "diff": None if diff is None else short_diff_json(diff),
    }


@contextmanager
def _waiting_pool() -> Iterator[WorkerPool]:
    """Processes for the entries, one core left to this one; they import while it reads and fits."""
    with WorkerPool(available_cores() - 1) as pool:
        pool.prepare(prepare_entries)
        yield pool


def _print_placed(out: Console, target: TableTarget, placed: InPlace | None) -> None:
    if placed is None:
        _say(out, f"{target.path}: left as it was, for the doubts; --despite-doubts applies them all the same")
    elif placed.after_s is None:
        _say(out, f"{target.path}: was put in place before")
    else:
        _say(out, f"{target.path}: in place {placed.after_s:.1f} s after the start; a run that plays it changes over")
        _say(out, f"  {times_text(placed.seconds)}")


def _print_clicks(out: Console, target: TableTarget, outdated: str, clicks_s: float | None) -> None:
    if clicks_s is not None:
        _say(out, f"{target.path}: {outdated} made anew in {clicks_s:.0f} s, put in place in a second change")
    elif outdated:
        _say(out, f"{target.path}: its {outdated} are still those of the bar before; without --no-clicks they are made")
    _say(out, f"back to the table before: tactable rollback {target.path}")


def _say(out: Console, text: str) -> None:
    out.print(text, markup=False, highlight=False, soft_wrap=True)
