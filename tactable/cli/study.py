"""The commands of studies: where actuators should go, and how narrow zones can be; each a picture with its data."""

import time
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from threadpoolctl import threadpool_limits

from engine.device import Device
from engine.device.file import ROMAN
from tactable.cli.plot import AsJson, CsvPath, Output, deliver, names_in
from tactable.figures.file import FigureError, check_paths
from tactable.progress import shown_progress
from tactable.shipped import find_device

study = typer.Typer(no_args_is_help=True, help="Search and compare bars that are not built: pictures and data.")
_out = Console(stderr=True)

_MOST_ACTUATORS = 4
_MOST_ZONES = len(ROMAN)

DeviceName = Annotated[str, typer.Argument(metavar="DEVICE", help="A device file, or a shipped name.")]
Level = Annotated[float, typer.Option("--level", min=0.0, max=60.0, help="Of the felt finger, dB above threshold.")]

Workers = Annotated[
    int | None, typer.Option("--workers", min=1, max=64, help="Processes that share the work; default: the cores.")
]


@study.command()
def placement(
    device_name: DeviceName,
    actuators: Annotated[str, typer.Option(help="Numbers of actuators, up to 4.")] = "2,3,4",
    level_db: Level = 20.0,
    most: Annotated[int, typer.Option(min=3, max=100_000, help="Placements screened for each number.")] = 300,
    workers: Workers = None,
    output: Output = Path("placement.png"),
    csv_path: CsvPath = None,
    as_json: AsJson = False,
) -> None:
    """Where actuators go for the best worst contrast between one felt and one quiet finger. A search, not a proof."""
    from precompute.parallel.pool import WorkerPool
    from precompute.studies.placement import search_placement
    from tactable.figures.placement import plot_placement

    check_paths(output, csv_path)
    device, counts = _two_zones(find_device(device_name)), _counts("--actuators", actuators, 1, _MOST_ACTUATORS)
    start_s, found = time.monotonic(), []
    with shown_progress(as_json) as progress, threadpool_limits(1, "blas"), WorkerPool(_helpers(workers)) as pool:
        for count in counts:
            told = partial(progress, f"{count} actuators")
            found.append(search_placement(device, count, level_db, most, told, pool))
    deliver(plot_placement(device, found, level_db), output, csv_path, as_json)
    if not as_json:
        looked = sum(len(search.screened_db) + search.moved for search in found)
        judged = sum(len(search.evaluated) for search in found)
        _say(
            f"looked at {looked} placements in {time.monotonic() - start_s:.0f} s, judged {judged} as a table would; "
            "not at states of more fingers, at clicks, or at anything but places"
        )


@study.command()
def resolution(
    device_name: DeviceName,
    zones: Annotated[str, typer.Option(help="Numbers of equal zones, 2 to 16.")] = "2,3,4,5,6,8",
    placements: Annotated[
        str, typer.Option("--at", help="Positions in % of the bar, placements parted by ;. Default: own, even 1, 3, 4.")
    ] = "",
    level_db: Level = 20.0,
    workers: Workers = None,
    output: Output = Path("resolution.png"),
    csv_path: CsvPath = None,
    as_json: AsJson = False,
) -> None:
    """How narrow zones can be with so many actuators: worst contrast of two fingers, and factor of the worst zone."""
    from precompute.parallel.pool import WorkerPool
    from precompute.studies.placement import even_places, own_places
    from precompute.studies.resolution import study_resolution
    from tactable.figures.resolution import plot_resolution

    check_paths(output, csv_path)
    device, counts = find_device(device_name), _counts("--zones", zones, 2, _MOST_ZONES)
    if placements:
        at_m = _read_placements(device, placements)
    else:
        own = own_places(device)
        at_m = sorted([own, *(even_places(device, n) for n in (1, 3, 4) if n != len(own))], key=len)
    with shown_progress(as_json) as progress, threadpool_limits(1, "blas"), WorkerPool(_helpers(workers)) as pool:
        found = study_resolution(device, at_m, counts, level_db, lambda done: progress("zones", done), pool)
    deliver(plot_resolution(device, found, level_db), output, csv_path, as_json)


def _helpers(workers: int | None) -> int:
    """Processes besides this one."""
    from precompute.parallel.pool import available_cores

    return (workers or available_cores()) - 1


def _two_zones(device: Device) -> Device:
    if len(device.zones) < 2:
        raise FigureError(f"{device.name}: two fingers need two zones, it has {len(device.zones)}")
    return device


def _counts(option: str, text: str, least: int, most: int) -> list[int]:
    """Whole numbers, each once, rising."""
    try:
        counts = sorted({int(part) for part in names_in(text)})
    except ValueError:
        counts = []
    if not counts or not all(least <= count <= most for count in counts):
        raise FigureError(f"{option} {text!r}: expected whole numbers from {least} to {most}, such as {least},{most}")
    return counts


def _read_placements(device: Device, text: str) -> list[tuple[float, ...]]:
    """Positions in metres, rising, of a text such as "16,97.7;10,50,90"."""
    found = []
    for part in text.split(";"):
        try:
            percent = sorted(float(number) for number in names_in(part))
        except ValueError:
            percent = []
        if not percent or len(set(percent)) < len(percent) or not all(0 <= at <= 100 for at in percent):
            raise FigureError(f"--at {text!r}: {part!r}: expected different places in % of the bar, such as 16,97.7")
        found.append(tuple(at / 100 * device.bar.length_m for at in percent))
    return found


def _say(text: str) -> None:
    _out.print(text, markup=False, highlight=False, soft_wrap=True)
