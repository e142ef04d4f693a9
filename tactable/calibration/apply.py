"""Apply a calibration to the table that a run plays: fit, build, verify and swap; clicks of two fingers in a second.

Theory of operation. The table is looked at before anything is fitted, so that a table that cannot be rebuilt is
refused at once. The table is then built for the calibrated device with the options of its first build, but with the
clicks of one finger alone, so that a run changes over after seconds: it solves the others as fingers ask for them.
`complete` adds them. Before a table takes its place it may be played on the bar (`verify`): one whose promise the bar
does not keep is doubtful, and the one before stays. Every step recognises its own finished work (the folder by what was
asked for, the table by its fingerprints), so the same command continues after an interruption and does nothing twice.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from base.errors import TactableError
from engine.device import Device
from engine.table import Table, TableError
from engine.table.history import previous_of
from engine.table.table_diff import TableDiff, compare_tables
from precompute.builder.code_fingerprint import code_fingerprint
from precompute.builder.incremental import BuildOptions, is_compatible, is_current
from precompute.builder.table_build import build_table
from precompute.parallel.pool import available_cores
from tactable.calibration.job import CalibrationJob, Progress, StepTimes

Verify = Callable[[Path], str]  # plays a finished table before it takes its place; the doubt, empty for none


class PromiseError(TactableError):
    """The bar does not keep what a new table promises; the message says how far."""


class TableTarget:
    """The table that a calibration is applied to. Raises TableError for none, another bar's, or one not rebuildable."""

    def __init__(self, path: Path, device: Device) -> None:
        self.path = path
        with Table.open(path, verify=False) as table:
            if table.device.name != device.name or not is_compatible(table.device, device):
                asked = f"{device.name!r} with its zones, actuators and limits"
                raise TableError(f"{path}: is of {table.device.name!r}, not of {asked}; name the table of this bar")
            self._options = replace(BuildOptions.of(table), code_fingerprint=code_fingerprint())
        self._first = replace(self._options, clicks_up_to=min(1, self._options.clicks_up_to))
        if self._options.responses_sha256:
            raise TableError(
                f"{path}: was built from measured responses, which a calibration does not change; measure them again "
                "and build it with --responses"
            )

    def is_in_place(self, device: Device) -> bool:
        """Whether the table is the one of `device` already, if only with the clicks of one finger."""
        with Table.open(self.path, verify=False) as table:
            return any(is_current(table, device, options) for options in (self._options, self._first))

    def is_complete(self, device: Device) -> bool:
        """Whether the table has all clicks of `device`."""
        with Table.open(self.path, verify=False) as table:
            return is_current(table, device, self._options)

    def put_in_place(
        self, device: Device, progress: Progress, verify: Verify | None = None, *, completes: bool = False
    ) -> None:
        """Build the table for `device` as it was built before: with the clicks of one finger alone, or all of them.

        Raises TableError, PromiseError for a table that `verify` refuses.
        """

        def accept(written: Path) -> None:
            if verify is not None:
                progress("verify on the bar", 0.98)
                if doubt := verify(written):
                    raise PromiseError(doubt)

        options = self._options if completes else self._first
        build_table(
            device,
            self.path,
            clicks_up_to=options.clicks_up_to,
            in_the_end=self._options.clicks_up_to,
            click_options=options.click_options,
            workers=available_cores(),
            completes=completes,
            progress=progress,
            accept=accept,
        )

    def complete(self, device: Device, progress: Progress, verify: Verify | None = None) -> float:
        """Add the clicks of two fingers; the seconds that it took. Raises as `put_in_place`."""
        times = StepTimes(progress, "clicks")
        self.put_in_place(device, times.tell_step, verify, completes=True)
        return times.total_s

    def diff(self) -> TableDiff | None:
        """Compare the table with the previous one; None where that is not kept."""
        before = previous_of(self.path)
        if not before.is_file():
            return None
        with Table.open(before, verify=False) as own, Table.open(self.path, verify=False) as other:
            return compare_tables(own, other)


@dataclass(frozen=True)
class Applied:
    """A calibration and what became of the table."""

    target: TableTarget
    device: Device  # the device as calibrated
    report: dict[str, Any]
    doubts: list[str]
    is_refused: bool  # the fit is doubtful and the table was left as it was
    in_place_after_s: float | None = None  # from the start until the table was in place; None: left, or there before
    seconds: dict[str, float] = field(default_factory=dict)  # time of each step


def apply_fit(
    job: CalibrationJob, table: Path, despite_doubts: bool, progress: Progress, verify: Verify | None = None
) -> Applied:
    """Fit, build the table for the calibrated device and put it in place; a finished step is not repeated.

    A doubtful fit, and a table that `verify` refuses, leave the table, unless `despite_doubts`. Raises as its steps.
    """
    times = StepTimes(progress, "start")
    target = TableTarget(table, job.device)
    kept = job.kept_report()
    if kept is None:
        fitted = job.fit(times.tell_step)
        report, device = fitted.report, fitted.device(str(job.device_file))
    else:
        report, device = kept, Device.read(job.device_file)
    doubts = job.doubts_of(report)
    applied = Applied(target, device, report, doubts, bool(doubts) and not despite_doubts)
    if not applied.is_refused and not target.is_in_place(device):
        try:
            target.put_in_place(device, times.tell_step, None if despite_doubts else verify)
            applied = replace(applied, in_place_after_s=times.total_s, seconds=times.read())
        except PromiseError as refused:
            applied = replace(applied, doubts=[*doubts, str(refused)], is_refused=True)
    times.tell_step("report", 1.0)
    if kept is None:  # after the table: the report's picture takes as long as the fit
        job.write(fitted)
    return applied
