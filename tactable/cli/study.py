"""Commands `study ...`: devices that are not built yet, searched and compared; each a picture with its data."""

import time
from dataclasses import replace
from functools import partial
from typing import Annotated

import typer

from base.points import order_of
from engine.device import Device
from engine.device.surface_description import ROMAN
from tactable.cli.console import Progress, remark
from tactable.cli.options import AsJson, DeviceArgument, OptionError, Workers, names_in, read_counts
from tactable.cli.plot import picture_command
from tactable.figures.picture_file import Picture
from tactable.shipped import find_device

_MOST_ACTUATORS = 4
_MOST_ZONES = len(ROMAN)

Level = Annotated[
    float, typer.Option("--level", min=0.0, max=60.0, help="Level of the felt finger, dB above threshold.")
]


@picture_command
def placement(
    device_name: DeviceArgument,
    progress: Progress,
    actuators: Annotated[str, typer.Option(help=f"Numbers of actuators, up to {_MOST_ACTUATORS}.")] = "2,3,4",
    level_db: Level = 20.0,
    most: Annotated[int, typer.Option(min=3, max=100_000, help="Placements to screen for each number.")] = 300,
    workers: Workers = None,
    as_json: AsJson = False,
) -> Picture:
    """Search where actuators give the best worst contrast.

    Beside the picture it writes the device file of the best placement of each number of actuators. The worst
    contrast is that of one felt and one quiet finger in the least favourable zones. A search, not a proof.
    """
    from precompute.parallel.pool import WorkerPool
    from precompute.studies.placed_device import placed_text
    from precompute.studies.placement_search import search_placement
    from tactable.figures.placement_picture import plot_placement

    device, counts = find_device(device_name), read_counts("--actuators", actuators, 1, _MOST_ACTUATORS)
    if len(device.zones) < 2:
        raise OptionError(f"{device.name}: two fingers need two zones, it has {len(device.zones)}")
    start_s, found = time.monotonic(), []
    with WorkerPool(_helpers(workers)) as pool:
        for count in counts:
            told = partial(progress, f"{count} actuators")
            found.append(search_placement(device, count, level_db, most, told, pool))
    if not as_json:
        looked = sum(len(search.screened_db) + search.moved for search in found)
        evaluated = sum(len(search.evaluated) for search in found)
        remark(
            f"looked at {looked} placements in {time.monotonic() - start_s:.0f} s, evaluated {evaluated} as a table "
            "would; not at states of more fingers, at clicks, or at anything but places"
        )
    texts = {}
    for search in found:
        name = f"{device.name}-{search.count}-placed"
        texts[f"{name}.toml"] = placed_text(device, name, search.evaluated[0].position_m)
    return replace(plot_placement(device, found, level_db), texts=texts)


@picture_command
def resolution(
    device_name: DeviceArgument,
    progress: Progress,
    zones: Annotated[str, typer.Option(help=f"Numbers of equal zones, 2 to {_MOST_ZONES}.")] = "2,3,4,5,6,8",
    placements: Annotated[
        str,
        typer.Option(
            "--at",
            help="Positions of actuators in % of the bar, or of a plate's sides as 10x15, placements separated by ;. "
            "Default: the device's, and 1, 3 and 4 evenly spaced.",
        ),
    ] = "",
    level_db: Level = 20.0,
    workers: Workers = None,
) -> Picture:
    """Study how narrow zones can be with a number of actuators.

    The figure shows the worst contrast of two fingers, and the localized factor of the worst zone.
    """
    from precompute.parallel.pool import WorkerPool
    from precompute.studies.placement_search import even_places, own_places
    from precompute.studies.zone_resolution import study_resolution
    from tactable.figures.resolution_picture import plot_resolution

    device, counts = find_device(device_name), read_counts("--zones", zones, 2, _MOST_ZONES)
    if placements:
        at_m = _read_placements(device, placements)
    else:
        own = own_places(device)
        at_m = sorted([own, *(even_places(device, n) for n in (1, 3, 4) if n != len(own))], key=len)
    with WorkerPool(_helpers(workers)) as pool:
        found = study_resolution(device, at_m, counts, level_db, partial(progress, "zones"), pool)
    return plot_resolution(device, found, level_db)


def _helpers(workers: int | None) -> int:
    """Number of processes besides this one."""
    from precompute.parallel.pool import available_cores

    return (workers or available_cores()) - 1


def _read_placements(device: Device, text: str) -> list[tuple[complex, ...]]:
    """Points in metres, in order, of a text such as "16,97.7;10,50,90" or "10x15,90x85". Raises OptionError."""
    from engine.device.quantity import QuantityError, read_point_on

    found = list[tuple[complex, ...]]()
    for part in text.split(";"):
        try:
            at_m = {read_point_on(f"{each} %", device.surface.corner_m) for each in names_in(part)}
        except QuantityError as error:
            raise OptionError(f"--at {text!r}: {error}") from None
        if not at_m or len(at_m) < len(names_in(part)):
            raise OptionError(
                f"--at {text!r}: {part!r}: expected different places in %, such as 16,97.7 or 10x15,90x85"
            )
        found.append(tuple(sorted(at_m, key=order_of)))
    return found
