"""The commands around figures: a table to pictures, their data and a summary."""

import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from engine.table import Table
from engine.table.entry import DEFAULT_LEVEL_DB
from tactable.figures.file import FigureError, Picture, check_paths, write_columns, write_picture

plot = typer.Typer(no_args_is_help=True, help="Draw what a table holds: PNG, SVG or PDF, and the data as CSV.")
_out = Console()

TablePath = Annotated[Path, typer.Argument(metavar="TABLE", help="A built table.")]
Felt = Annotated[str, typer.Option(help="Zones with a finger that feels, such as I,III.")]
Quiet = Annotated[str, typer.Option(help="Zones with a finger that must not feel, such as IV.")]
Level = Annotated[float, typer.Option("--level", help="dB above the detection threshold; inf: full scale.")]
Output = Annotated[Path, typer.Option("-o", "--output", help="The picture; ends in .png, .svg or .pdf.")]
CsvPath = Annotated[Path | None, typer.Option("--csv", help="The data as CSV, units in the header.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print a summary as JSON for machines.")]


@plot.command()
def state(
    table_path: TablePath,
    felt: Felt,
    quiet: Quiet = "",
    level_db: Level = DEFAULT_LEVEL_DB,
    output: Output = Path("state.png"),
    csv_path: CsvPath = None,
    as_json: AsJson = False,
) -> None:
    """One state along the bar: acceleration under the fingers it may meet, against the detection threshold."""
    check_paths(output, csv_path)
    with opened_table(table_path) as table:
        from tactable.figures.state import plot_state

        entry = table.entry_for(named_zones("--felt", felt), names_in(quiet), checked_level(level_db))
        deliver(plot_state(table, entry), output, csv_path, as_json)


@plot.command()
def pareto(
    table_path: TablePath,
    felt: Felt,
    quiet: Quiet,
    output: Output = Path("pareto.png"),
    csv_path: CsvPath = None,
    as_json: AsJson = False,
) -> None:
    """One state: the contrast at every level that can be reached, and what the paper's objective gives."""
    check_paths(output, csv_path)
    with opened_table(table_path) as table:
        from tactable.figures.pareto import plot_pareto

        states = table.states_of(named_zones("--felt", felt), named_zones("--quiet", quiet))
        deliver(plot_pareto(table, states), output, csv_path, as_json)


@plot.command("contrast-map")
def contrast_map(
    table_path: TablePath,
    level_db: Level = DEFAULT_LEVEL_DB,
    output: Output = Path("contrast-map.png"),
    csv_path: CsvPath = None,
    as_json: AsJson = False,
) -> None:
    """All states of two fingers: the contrast of the felt one over the quiet one."""
    check_paths(output, csv_path)
    with opened_table(table_path) as table:
        from tactable.figures.contrast_map import plot_contrast_map

        deliver(plot_contrast_map(table, checked_level(level_db)), output, csv_path, as_json)


@plot.command()
def rise(
    table_path: TablePath,
    felt: Annotated[str, typer.Option(help="Zones that are felt: draw the course of this state; none: all.")] = "",
    quiet: Quiet = "",
    level_db: Level = DEFAULT_LEVEL_DB,
    output: Output = Path("rise.png"),
    csv_path: CsvPath = None,
    as_json: AsJson = False,
) -> None:
    """Rise times of all states, or one state from rest: how long until every felt finger has what is promised."""
    check_paths(output, csv_path)
    if quiet and not felt:
        raise FigureError(f"--quiet {quiet} is of one state; name what is felt in it, such as --felt I")
    with opened_table(table_path) as table:
        from tactable.figures.course import plot_course
        from tactable.figures.rise import plot_rise

        level = checked_level(level_db)
        if felt:
            picture = plot_course(table, table.entry_for(named_zones("--felt", felt), names_in(quiet), level))
        else:
            picture = plot_rise(table, level)
        deliver(picture, output, csv_path, as_json)


@plot.command()
def factor(
    table_path: TablePath,
    zones: Annotated[str, typer.Option(help="Zones whose common share is drawn, such as I,III; none: each.")] = "",
    fingers: Annotated[str, typer.Option(help="Zones with a finger: draw the bar with these fingers too.")] = "",
    amplitudes: Annotated[str, typer.Option(help="Of the two actuators, fractions of full scale.")] = "1,1",
    pair: Annotated[str, typer.Option(help="Names of two actuators; default: the first two.")] = "",
    output: Output = Path("factor.png"),
    csv_path: CsvPath = None,
    as_json: AsJson = False,
) -> None:
    """Localized factor of zones over the frequencies of two actuators."""
    check_paths(output, csv_path)
    with opened_table(table_path) as table:
        from tactable.figures.factor import pair_drive, plot_factor

        drive = pair_drive(table.device, names_in(pair), _numbers("--amplitudes", amplitudes))
        deliver(plot_factor(table, _combinations(table, zones), names_in(fingers), drive), output, csv_path, as_json)


@contextmanager
def opened_table(path: Path) -> Iterator[Table]:
    """The table, refused where other code built it: its entries and what is computed anew would not fit together."""
    from threadpoolctl import threadpool_limits

    from precompute.builder.code_fingerprint import code_fingerprint

    with Table.open(path, code_fingerprint=code_fingerprint()) as table, threadpool_limits(1, "blas"):
        yield table


def names_in(text: str) -> list[str]:
    """Names between commas."""
    return [name.strip() for name in text.split(",") if name.strip()]


def named_zones(option: str, text: str) -> list[str]:
    """Names of at least one zone; raises FigureError for none."""
    names = names_in(text)
    if not names:
        raise FigureError(f"{option} names no zone; give at least one, such as {option} I,III")
    return names


def _combinations(table: Table, text: str) -> list[list[str]]:
    """The zones that are named, together; every zone by itself where the text is empty."""
    return [named_zones("--zones", text)] if text else [[zone.name] for zone in table.device.zones]


def _numbers(option: str, text: str) -> list[float]:
    try:
        return [float(part) for part in names_in(text)]
    except ValueError:
        raise FigureError(f"{option} {text!r}: expected numbers, such as {option} 1,0.6") from None


def checked_level(level_db: float) -> float:
    """The level; raises FigureError for what is no number."""
    if math.isnan(level_db):
        raise FigureError("--level nan: expected dB above the detection threshold, such as --level 20")
    return level_db


def deliver(picture: Picture, output: Path, csv_path: Path | None, as_json: bool) -> None:
    """Write the picture and its data, and say what they show."""
    write_picture(picture, output)
    if csv_path is not None:
        write_columns(picture, csv_path)
    if as_json:
        files = {"figure": str(output), "csv": None if csv_path is None else str(csv_path)}
        print(json.dumps({**files, **picture.summary}, indent=2))  # noqa: T201  # without a terminal's width
        return
    _out.print(picture.caption, markup=False, highlight=False, soft_wrap=True)
    for path in (output, csv_path):
        if path is not None:
            _out.print(f"written: {path}", markup=False, highlight=False, soft_wrap=True)
