"""The commands around figures of clicks: one click, its sound, all of two fingers, and what length and plants give."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from engine.table.click import played_at
from engine.table.table import states_of
from tactable.cli.plot import (
    AsJson,
    CsvPath,
    Felt,
    Output,
    Quiet,
    TablePath,
    checked_level,
    deliver,
    named_zones,
    names_in,
    opened_table,
)
from tactable.figures.file import FigureError, check_paths
from tactable.progress import shown_progress
from tactable.shipped import find_device

_out = Console()

_MS_PER_S = 1e3
_LENGTHS_MS = (1.0, 200.0)
_PLANTS = (1.0, 1000.0)

ClickLevel = Annotated[
    float, typer.Option("--level", help="dB above the detection threshold, no louder; inf: as strong as it is.")
]


def register(plot: typer.Typer) -> None:
    """Put the commands of this module into `plot`."""
    plot.command()(click)
    plot.command("click-map")(click_map)
    plot.command("click-study")(click_study)


def click(
    table_path: TablePath,
    felt: Felt,
    quiet: Quiet = "",
    level_db: ClickLevel = math.inf,
    sound_path: Annotated[
        Path | None, typer.Option("--sound", help="What every finger feels as sound, one after another; ends in .wav.")
    ] = None,
    stereo: Annotated[bool, typer.Option("--stereo", help="The felt finger left, the quiet one right.")] = False,
    plain: Annotated[bool, typer.Option("--plain", help="Acceleration as it is, not weighted by threshold.")] = False,
    output: Output = Path("click.png"),
    csv_path: CsvPath = None,
    as_json: AsJson = False,
) -> None:
    """One click: its waveform, the acceleration under each finger, and its spread over fresh plants."""
    from tactable.explain.click_sound import check_sound_path, make_sound, sound_json, write_sound

    check_paths(output, csv_path)
    if sound_path is not None:
        check_sound_path(sound_path)
    elif stereo or plain:
        raise FigureError("--stereo and --plain are of a sound; name its file, such as --sound click.wav")
    with opened_table(table_path) as table:
        from tactable.explain.click_source import ClickSource
        from tactable.figures.click import plot_click

        states = table.states_of(named_zones("--felt", felt), names_in(quiet))
        source = ClickSource(table)
        played = played_at(source.solve_click(states), checked_level(level_db))
        if sound_path is None:
            deliver(plot_click(source, played), output, csv_path, as_json)
            return
        sound = make_sound(table.device, played, is_weighted=not plain, is_stereo=stereo)
        picture = plot_click(source, played)
        summary = {"sound": {"file": str(sound_path), **sound_json(sound)}, **picture.summary}
        write_sound(sound, sound_path)
        deliver(replace(picture, summary=summary), output, csv_path, as_json)
        if not as_json:
            _out.print(f"written: {sound_path}: {sound.words}", markup=False, highlight=False, soft_wrap=True)


def click_map(
    table_path: TablePath,
    output: Output = Path("click-map.png"),
    csv_path: CsvPath = None,
    as_json: AsJson = False,
) -> None:
    """All clicks of one felt and one quiet finger, beside the best steady drives gated for as long."""
    check_paths(output, csv_path)
    with opened_table(table_path) as table, shown_progress(as_json) as progress:
        from tactable.explain.click_source import ClickSource
        from tactable.figures.click_map import plot_click_map

        picture = plot_click_map(ClickSource(table), lambda done: progress("states", done))
    deliver(picture, output, csv_path, as_json)


def click_study(
    device_name: Annotated[str, typer.Argument(metavar="DEVICE", help="A device file, or a shipped name.")],
    felt: Felt,
    quiet: Quiet = "",
    lengths: Annotated[str, typer.Option(help="Of the click, ms.")] = "10,20,30,40",
    scenarios: Annotated[str, typer.Option(help="Numbers of plants that it is optimised over.")] = "5,10,20,40,80",
    output: Output = Path("click-study.png"),
    csv_path: CsvPath = None,
    as_json: AsJson = False,
) -> None:
    """One click: what it gains from its length, and from the number of plants it is optimised over."""
    from threadpoolctl import threadpool_limits

    from tactable.explain.click_study import run_study
    from tactable.figures.click_study import plot_click_study

    check_paths(output, csv_path)
    lengths_s = [length_ms / _MS_PER_S for length_ms in _rising("--lengths", lengths, _LENGTHS_MS)]
    counts = [round(count) for count in _rising("--scenarios", scenarios, _PLANTS)]
    device = find_device(device_name)
    states = states_of(device, named_zones("--felt", felt), names_in(quiet))
    with shown_progress(as_json) as progress, threadpool_limits(1, "blas"):
        study = run_study(
            device, states, lengths_s=lengths_s, scenarios=counts, told=lambda done: progress("clicks", done)
        )
    deliver(plot_click_study(study), output, csv_path, as_json)


def _rising(option: str, text: str, ends: tuple[float, float]) -> list[float]:
    """Whole numbers, each once, the least first."""
    try:
        values = sorted({float(part) for part in names_in(text)})
    except ValueError:
        values = []
    if not values or not all(ends[0] <= value <= ends[1] and value.is_integer() for value in values):
        raise FigureError(f"{option} {text!r}: expected whole numbers from {ends[0]:g} to {ends[1]:g}, such as 10,20")
    return values
