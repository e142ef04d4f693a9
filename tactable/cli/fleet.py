"""The command `tactable fleet`: many devices, or many variations of one, calibrated, built and verified."""

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from tactable.progress import shown_progress

EXIT_FAILED = 3
SUMMARY = "summary"
_out = Console()


def register(app: typer.Typer) -> None:
    """Add the command to `app`."""
    app.command("fleet")(fleet)


def fleet(
    source: Annotated[
        Path,
        typer.Argument(metavar="DIR|MANIFEST|STUDY", help="A folder of folders, .toml or .csv (docs/fleet.md)."),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the results; what is there is kept.")],
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="A Dask scheduler that runs, such as tcp://host:8786.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes of this machine; default: one unit after another in this one.")
    ] = None,
    objective: Annotated[
        str, typer.Option(help="contrast, standard contrast, localized factor, fair share or paper.")
    ] = "contrast",
    clicks_up_to: Annotated[
        int | None, typer.Option(min=0, help="Clicks for states of up to so many fingers; default as for build.")
    ] = None,
    loss: Annotated[str, typer.Option(help="Of calibrations: robust, squares or l1.")] = "robust",
    fit: Annotated[list[str] | None, typer.Option(metavar="NAME", help="Fit only these values. Repeat.")] = None,
    also: Annotated[list[str] | None, typer.Option(metavar="NAME", help="Fit these besides the usual. Repeat.")] = None,
    sensor_mass: Annotated[str, typer.Option(help="Of the accelerometer, where a file has none.")] = "0 g",
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON for machines.")] = False,
) -> None:
    """Calibrate, build and verify many devices; run again, it goes on where it was. Exit status 3: a unit failed."""
    from engine.files import replace_file
    from precompute.fleet.plan import plan_fleet
    from precompute.fleet.run import run_fleet, run_here, run_on_processes, run_on_scheduler
    from precompute.fleet.summary import summarise, summary_csv, summary_json
    from precompute.fleet.units import FleetError, FleetOptions
    from tactable.cli.calibrate_options import read_option
    from tactable.cli.fleet_page import print_fleet

    if scheduler is not None and workers is not None:
        raise FleetError("--workers and --scheduler: give one of them; a scheduler has its own workers")
    options = FleetOptions(
        objective=objective,
        clicks_up_to=clicks_up_to,
        loss=loss,
        parameters=tuple(fit) if fit else None,
        also=tuple(also or ()),
        sensor_mass_kg=read_option("--sensor-mass", sensor_mass, "kg"),
    )
    units = plan_fleet(source)
    if output.exists() and source.is_dir() and output.resolve() == source.resolve():
        raise FleetError(f"{output}: is where the units are; choose another folder for the results")
    output.mkdir(parents=True, exist_ok=True)
    for ending in (".csv", ".json"):
        (output / f"{SUMMARY}{ending}").unlink(missing_ok=True)  # until this run is done, there is none
    pool = run_on_scheduler(scheduler) if scheduler else run_on_processes(workers) if workers else run_here
    with shown_progress(as_json) as progress:
        outcomes = run_fleet(
            units, options, output, pool, created=datetime.now(UTC).isoformat(timespec="seconds"), progress=progress
        )
    summary = summarise(units, outcomes)
    values = summary_json(summary)
    for ending, text in ((".csv", summary_csv(summary)), (".json", json.dumps(values, indent=1))):
        with replace_file(output / f"{SUMMARY}{ending}") as partial:
            partial.write_text(text, encoding="utf-8")
    if as_json:
        print(json.dumps(values, indent=2))  # noqa: T201  # JSON goes out as it is, without a terminal's width
    else:
        print_fleet(_out, summary, output / f"{SUMMARY}.csv")
    if summary.failed:
        raise typer.Exit(EXIT_FAILED)
