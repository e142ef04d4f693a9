"""Commands `explain`, `diff` and `export`: what a table gives some fingers and why, what changed, and its arrays."""

from pathlib import Path
from typing import Annotated

import typer
from threadpoolctl import threadpool_limits
from typer import Argument, Option

from base.errors import TactableError
from base.files import replace_file
from engine.device import Device
from engine.effects.rules import Drives
from engine.table import Table
from engine.table.levels import DEFAULT_LEVEL_DB
from engine.table.table_diff import DEFAULT_LIMIT_DB, Tolerance, compare_tables
from engine.touch import Placement
from tactable.cli import options
from tactable.cli.console import print_error, say, show, shown_work
from tactable.explain.diff_words import diff_json, print_diff

EXIT_DIFFERS = 1
EXIT_TROUBLE = 2


def explain(
    table_path: options.TableArgument,
    felt: options.FeltFingers,
    quiet: options.QuietFingers = "",
    level: options.Level = f"{DEFAULT_LEVEL_DB:g}",
    threshold: options.PressedThreshold = None,
    click: Annotated[bool, Option("--click", help="Explain the click, not the steady drive.")] = False,
    summation: Annotated[
        str, Option(help="With --click: levels of the fingers by peaks (none), or corrected: zwislocki-1960.")
    ] = "none",
    drives: options.DrivesOf = None,
    as_json: options.AsJson = False,
) -> None:
    """Explain what is played for some fingers.

    It says what is played, what every finger feels, and how that varies over sampled bars and fingers. A zone's name
    means its middle. --drives zones: the row of the sweep. With --threshold a steady drive is solved for a person
    of that curve, who presses so; clicks and rows need a table that is built for it.
    """
    level_db = options.read_level(level)
    by_zones = drives is not None and options.read_drives_of(drives) is Drives.ZONES
    if threshold is not None and (click or by_zones):
        raise options.OptionError(
            f"--threshold {threshold}: rows and clicks are made for the curve of their table; leave --click and "
            f"--drives out, or build a table with `tactable build DEVICE --threshold {threshold.partition(',')[0]}`"
        )
    with Table.open(table_path) as table, threadpool_limits(1, "blas"):
        placement = options.read_placement(table.device, felt, quiet)
        if click:
            _explain_click(table, placement, level_db, summation, as_json)
        elif by_zones:
            _explain_row(table, placement, level_db, as_json)
        else:
            device = options.with_pressing(table.device, threshold)
            _explain_drive(table, device, placement, level_db, as_json)


def _explain_row(table: Table, placement: Placement, level_db: float, as_json: bool) -> None:
    from tactable.explain.placed_drive import ExplainedRow, best_row_json, print_best_row

    explained = ExplainedRow(table, placement, level_db)
    show(best_row_json(explained), as_json, lambda out, _: print_best_row(out, explained))


def _explain_click(table: Table, placement: Placement, level_db: float, summation: str, as_json: bool) -> None:
    from tactable.explain.click_source import ClickSource, Summation
    from tactable.explain.explained_click import click_json, explain_click, print_click

    source = ClickSource(table, summation=options.read_choice("--summation", summation, Summation))
    with shown_work("solving the click for these positions, over sampled bars and fingers", as_json):
        explained = explain_click(source, placement, level_db)
    show(click_json(table, explained), as_json, lambda out, _: print_click(out, table, explained))


def _explain_drive(table: Table, device: Device, placement: Placement, level_db: float, as_json: bool) -> None:
    from tactable.explain.placed_drive import designer_of, placed_drive_json, print_placed_drive

    with shown_work("solving the drive for these positions", as_json):
        figures = designer_of(table, device).solve(placement.position_m, placement.is_felt, level_db)
    found = placed_drive_json(table, figures, device.threshold)
    show(found, as_json, lambda out, _: print_placed_drive(out, table, figures, device.threshold))


def diff(
    before: Annotated[Path, Argument(metavar="BEFORE", help="A built table.")],
    after: Annotated[Path, Argument(metavar="AFTER", help="The table to compare with it.")],
    limit_db: Annotated[
        float, Option("--limit", min=0.0, max=100.0, help="Ignore changes up to this many dB, or as much in per cent.")
    ] = DEFAULT_LIMIT_DB,
    as_json: options.AsJson = False,
) -> None:
    """Compare two tables, as a whole, row by row and click by click.

    Exit status 0: no difference, 1: they differ, 2: an error.
    """
    try:
        with Table.open(before) as own, Table.open(after) as other:
            found = compare_tables(own, other, Tolerance(limit_db))
    except (TactableError, OSError) as error:
        print_error(error)
        raise typer.Exit(EXIT_TROUBLE) from None
    show(diff_json(found), as_json, lambda out, _: print_diff(out, found))
    if found.differs:
        raise typer.Exit(EXIT_DIFFERS)


def export(
    table_path: options.TableArgument,
    group: Annotated[
        str, Argument(help="sweep, coherent_sweep, best_rows, responses, modes or clicks, as in tables/FORMAT.md.")
    ],
    path: Annotated[Path, Option("-o", "--output", help="The file to write; ends in .nc, .csv or .mat.")],
) -> None:
    """Write a part of a table as NetCDF, CSV or MATLAB.

    NetCDF and MATLAB files hold every array of the part. CSV has a line for each row: of the sweep its two frequencies
    and amplitudes with the figures of every zone, of the clicks one click.
    """
    from tactable.research.played import Table as NotebookTable
    from tactable.research.table_export import write_csv, write_matlab, write_netcdf

    writers = {".nc": write_netcdf, ".csv": write_csv, ".mat": write_matlab}
    if (write := writers.get(path.suffix.lower())) is None:
        raise options.OptionError(f"--output {path}: expected a name that ends in {', '.join(writers)}")
    with NotebookTable.open(table_path) as table, table.to_xarray(group) as found, replace_file(path) as made:
        names = write(found, group, made)
    say(f"{path}: {group} of {table.device.name}: {', '.join(names)}")
