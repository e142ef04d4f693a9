"""Command `fleet`: many devices, or many variations of one, calibrated, built and verified."""

import json
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table as Grid
from rich.text import Text
from typer import Argument, Option

from tactable.cli import options
from tactable.cli.console import EXIT_DOUBTFUL, OUT, say, show, shown_progress

if TYPE_CHECKING:
    from precompute.fleet.summary import Summary
    from precompute.fleet.verdict import Limits

SUMMARY = "summary"
_SHOWN = 20  # a screen's worth; the summary file has all


def fleet(
    source: Annotated[Path, Argument(metavar="DIR|MANIFEST|STUDY", help="Folders, .toml or .csv (docs/fleet.md).")],
    output: Annotated[Path, Option("-o", "--output", help="Folder of the results; complete ones are kept.")],
    scheduler: Annotated[str | None, Option(metavar="ADDRESS", help="A Dask scheduler, as tcp://host:8786.")] = None,
    workers: Annotated[
        int | None, Option(min=1, help="Processes of this machine; default: one unit after another in this one.")
    ] = None,
    clicks_up_to: options.ClicksUpTo = None,
    pitch: options.Pitch = None,
    loss: options.Loss = "robust",
    fit: options.Fit = None,
    also: options.Also = None,
    sensor_mass: options.SensorMass = "0 g",
    as_json: options.AsJson = False,
) -> None:
    """Calibrate, build and verify many devices; an interrupted run continues.

    Each measured unit gets a verdict (PASS, RETEST or REJECT) and a page, report.md. Exit status 3: one failed or did
    not pass.
    """
    from precompute.fleet.fleet_plan import plan_fleet
    from precompute.fleet.fleet_run import run_fleet, run_here, run_on_processes, run_on_scheduler
    from precompute.fleet.summary import summarise, summary_json
    from precompute.fleet.units import FleetOptions
    from precompute.fleet.verdict import read_limits

    if scheduler is not None and workers is not None:
        raise options.OptionError("--workers and --scheduler: give one of them; a scheduler has its own workers")
    fleet_options = FleetOptions(
        clicks_up_to=clicks_up_to,
        pitch_m=options.read_pitch(pitch),
        loss=loss,
        parameters=tuple(fit) if fit else None,
        also=tuple(also or ()),
        sensor_mass_kg=options.read_option("--sensor-mass", sensor_mass, "kg"),
    )
    units, limits = plan_fleet(source), read_limits(source)
    if output.exists() and source.is_dir() and output.resolve() == source.resolve():
        raise options.OptionError(
            f"--output {output}: is the folder of the units; choose another folder for the results"
        )
    output.mkdir(parents=True, exist_ok=True)
    for path in _summary_paths(output):
        path.unlink(missing_ok=True)  # a summary means that the run was completed
    pool = run_on_scheduler(scheduler) if scheduler else run_on_processes(workers) if workers else run_here
    created = datetime.now(UTC).isoformat(timespec="seconds")
    with shown_progress(as_json) as progress:
        outcomes = run_fleet(units, fleet_options, output, pool, created=created, progress=progress)
    summary = summarise(units, outcomes, limits)
    _write_summary(summary, output, limits)
    show(summary_json(summary), as_json, lambda *_: print_fleet(summary, _summary_paths(output)[0]))
    if not summary.is_passed:
        raise typer.Exit(EXIT_DOUBTFUL)


def _summary_paths(output: Path) -> tuple[Path, Path]:
    return output / f"{SUMMARY}.csv", output / f"{SUMMARY}.json"


def _write_summary(summary: "Summary", output: Path, limits: "Limits") -> None:
    """Write the page of each measured unit, and last the summary."""
    from base.files import write_text
    from precompute.fleet.summary import summary_csv, summary_json
    from precompute.fleet.unit_report import REPORT, unit_report

    judged = [outcome for outcome in summary.outcomes if outcome.name in summary.verdicts]
    texts = {output / each.name / REPORT: unit_report(each, summary, limits) for each in judged}
    of_lot = (summary_csv(summary), json.dumps(summary_json(summary), indent=1))
    texts |= zip(_summary_paths(output), of_lot, strict=True)
    for path, text in texts.items():
        path.parent.mkdir(exist_ok=True)  # of a unit that failed there may be none
        write_text(path, text)


def print_fleet(summary: "Summary", path: Path) -> None:
    """Print what became of the units and why, what varies and who stands out; `path` has the complete summary."""
    from precompute.fleet.summary import OUTLYING, status_of
    from precompute.fleet.verdict import FEWEST

    counts = Counter(status_of(outcome) for outcome in summary.outcomes)
    parts = (f"{counts['built']} built", f"{counts['kept']} complete already", f"{counts['failed']} failed")
    say(f"{len(summary.outcomes)} units: {', '.join(parts)}")
    for outcome in summary.failed:
        say(f"FAILED {outcome.name}: {outcome.error}")
    _print_verdicts(summary)
    if summary.columns:
        drifts = ["drift"] if any(column.drift is not None for column in summary.columns) else []
        grid = Grid("what varies", "median", "spread", *drifts, "least", "greatest")
        for column in summary.columns:
            if column.name.startswith("uncertainty."):
                continue
            ends = ((column.least, column.least_unit), (column.greatest, column.greatest_unit))
            cells = (Text(f"{value:.5g} ({unit})") for value, unit in ends)
            drift = ["" if column.drift is None else f"{column.drift:+.2g}"] if drifts else []
            grid.add_row(Text(column.name), f"{column.median:.5g}", f"{column.spread:.2g}", *drift, *cells)
        OUT.print(grid)
    rejected = [name for name, each in summary.verdicts.items() if each.judgement.value == "REJECT"]
    medians = {column.name: column.median for column in summary.columns}
    _say_first(
        [
            f"stands out {outlier.unit}: {outlier.column} is {outlier.value:.5g}, "
            f"where the others' median is {medians[outlier.column]:.5g}"
            for outlier in summary.outliers
            if outlier.unit not in rejected
        ]
    )
    if not summary.outliers:
        say(f"no unit stands out by more than {OUTLYING} spreads; of fewer than {FEWEST} none ever does")
    say(f"complete summary: {path}")


def _print_verdicts(summary: "Summary") -> None:
    """Print who did not pass and why, and the figures of the line."""
    measured = sum(summary.counts.values())
    if not measured:
        return
    for name, verdict in summary.verdicts.items():
        if verdict.reasons and name not in {outcome.name for outcome in summary.failed}:
            first, *rest = verdict.reasons
            more = f" (and {len(rest)} more in its report)" if rest else ""
            say(f"{verdict.judgement.value} {name}: {first}{more}")
    counts = ", ".join(f"{count} {word}" for word, count in summary.counts.items())
    takt = "" if summary.takt_s is None else f"; {summary.takt_s:.3g} s a bar on this machine"
    say(f"{counts}: {100 * summary.counts['PASS'] / measured:.0f} % passed{takt}")


def _say_first(lines: list[str]) -> None:
    for line in lines[:_SHOWN]:
        say(line)
    if len(lines) > _SHOWN:
        say(f"  and {len(lines) - _SHOWN} more")
