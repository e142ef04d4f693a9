"""Command `fleet`: many devices, or many variations of one, calibrated, built and verified."""

import json
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table as Grid
from rich.text import Text

from tactable.cli.console import EXIT_DOUBTFUL, OUT, say, show, shown_progress
from tactable.cli.options import (
    Also,
    AsJson,
    ClicksUpTo,
    Fit,
    Loss,
    OptionError,
    Pitch,
    SensorMass,
    read_option,
    read_pitch,
)

if TYPE_CHECKING:
    from precompute.fleet.summary import Summary

SUMMARY = "summary"
_SHOWN = 20  # a screen's worth; the summary file has all


def fleet(
    source: Annotated[
        Path, typer.Argument(metavar="DIR|MANIFEST|STUDY", help="A folder of folders, .toml or .csv (docs/fleet.md).")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder of the results; complete ones are kept.")],
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="A running Dask scheduler, such as tcp://host:8786.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes of this machine; default: one unit after another in this one.")
    ] = None,
    clicks_up_to: ClicksUpTo = None,
    pitch: Pitch = None,
    loss: Loss = "robust",
    fit: Fit = None,
    also: Also = None,
    sensor_mass: SensorMass = "0 g",
    as_json: AsJson = False,
) -> None:
    """Calibrate, build and verify many devices; an interrupted run continues.

    Exit status 3: a unit failed.
    """
    from precompute.fleet.fleet_plan import plan_fleet
    from precompute.fleet.fleet_run import run_fleet, run_here, run_on_processes, run_on_scheduler
    from precompute.fleet.summary import summarise, summary_json
    from precompute.fleet.units import FleetOptions

    if scheduler is not None and workers is not None:
        raise OptionError("--workers and --scheduler: give one of them; a scheduler has its own workers")
    options = FleetOptions(
        clicks_up_to=clicks_up_to,
        pitch_m=read_pitch(pitch),
        loss=loss,
        parameters=tuple(fit) if fit else None,
        also=tuple(also or ()),
        sensor_mass_kg=read_option("--sensor-mass", sensor_mass, "kg"),
    )
    units = plan_fleet(source)
    if output.exists() and source.is_dir() and output.resolve() == source.resolve():
        raise OptionError(f"--output {output}: is the folder of the units; choose another folder for the results")
    output.mkdir(parents=True, exist_ok=True)
    for path in _summary_paths(output):
        path.unlink(missing_ok=True)  # a summary means that the run was completed
    pool = run_on_scheduler(scheduler) if scheduler else run_on_processes(workers) if workers else run_here
    created = datetime.now(UTC).isoformat(timespec="seconds")
    with shown_progress(as_json) as progress:
        outcomes = run_fleet(units, options, output, pool, created=created, progress=progress)
    summary = summarise(units, outcomes)
    _write_summary(summary, output)
    show(summary_json(summary), as_json, lambda *_: print_fleet(summary, _summary_paths(output)[0]))
    if summary.failed:
        raise typer.Exit(EXIT_DOUBTFUL)


def _summary_paths(output: Path) -> tuple[Path, Path]:
    return output / f"{SUMMARY}.csv", output / f"{SUMMARY}.json"


def _write_summary(summary: "Summary", output: Path) -> None:
    from base.files import replace_file
    from precompute.fleet.summary import summary_csv, summary_json

    texts = (summary_csv(summary), json.dumps(summary_json(summary), indent=1))
    for path, text in zip(_summary_paths(output), texts, strict=True):
        with replace_file(path) as partial:
            partial.write_text(text, encoding="utf-8")


def print_fleet(summary: "Summary", path: Path) -> None:
    """Print how many units are done, which failed and why, what varies, and which units stand out.

    `path` is the file of the complete summary.
    """
    from precompute.fleet.summary import FEWEST, OUTLYING, status_of

    counts = Counter(status_of(outcome) for outcome in summary.outcomes)
    parts = (f"{counts['built']} built", f"{counts['kept']} complete already", f"{counts['failed']} failed")
    say(f"{len(summary.outcomes)} units: {', '.join(parts)}")
    for outcome in summary.failed:
        say(f"FAILED {outcome.name}: {outcome.error}")
    _say_first([f"doubtful {unit.name}: {'; '.join(unit.doubts)}" for unit in summary.outcomes if unit.doubts])
    if summary.columns:
        grid = Grid("what varies", "median", "spread", "least", "greatest")
        for column in summary.columns:
            ends = ((column.least, column.least_unit), (column.greatest, column.greatest_unit))
            cells = (Text(f"{value:.5g} ({unit})") for value, unit in ends)
            grid.add_row(Text(column.name), f"{column.median:.5g}", f"{column.spread:.2g}", *cells)
        OUT.print(grid)
    _say_first(
        [
            f"stands out {outlier.unit}: {outlier.column} is {outlier.value:.5g}, "
            f"{outlier.deviation:+.1f} spreads from the median"
            for outlier in summary.outliers
        ]
    )
    if not summary.outliers:
        say(f"no unit stands out by more than {OUTLYING} spreads; of fewer than {FEWEST} none ever does")
    say(f"complete summary: {path}")


def _say_first(lines: list[str]) -> None:
    for line in lines[:_SHOWN]:
        say(line)
    if len(lines) > _SHOWN:
        say(f"  and {len(lines) - _SHOWN} more")
