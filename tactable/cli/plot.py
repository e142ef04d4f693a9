"""Commands `plot ...` and `study ...`: each draws one picture, with its data as CSV and a summary for machines.

A command here is a function from a table or a device to a `Picture`. `picture_command` adds the options that say where
the picture goes and writes it, so that every figure has the same ones.
"""

import inspect
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial, wraps
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from threadpoolctl import threadpool_limits
from typer import Option

from base.plain import to_plain
from base.points import order_of
from engine.device import Device
from engine.device.surface_description import ROMAN
from engine.table import Table
from engine.table.levels import DEFAULT_LEVEL_DB
from tactable.cli import options
from tactable.cli.console import Progress, print_json, remark, say, shown_progress
from tactable.figures.picture_file import Outputs, Picture, outputs_of, write_outputs, write_texts
from tactable.shipped import find_device

_DEFAULT_LEVEL = f"{DEFAULT_LEVEL_DB:g}"
_MOST_ACTUATORS = 4
_MOST_ZONES = len(ROMAN)
StudiedLevel = Annotated[float, Option("--level", min=0.0, max=60.0, help="Level of felt fingers, dB above threshold.")]


def picture_command(draw: Callable[..., Picture]) -> Callable[..., None]:
    """Make a command of a function that draws: it gets the options --output and --json.

    Numerical libraries keep to one thread meanwhile. A function with a parameter `as_json` or `progress` is given the
    option's value, or the function that shows progress.
    """
    own = inspect.signature(draw).parameters
    name = draw.__name__.replace("_", "-")
    shared = {"output": (options.PictureOutputs, None), "as_json": (options.AsJson, False)}

    @wraps(draw)
    def command(*, output: list[Path] | None, as_json: bool, **given: Any) -> None:
        outputs = outputs_of(output or [Path(f"{name}.png")])
        with threadpool_limits(1, "blas"), shown_progress(as_json or "progress" not in own) as progress:
            offered = {"as_json": as_json, "progress": progress}
            picture = draw(**given, **{key: value for key, value in offered.items() if key in own})
        _deliver(picture, outputs, as_json)

    parameters = [parameter for key, parameter in own.items() if key not in (*shared, "progress")]
    parameters += [
        inspect.Parameter(key, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
        for key, (annotation, default) in shared.items()
    ]
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]  # typer reads it
    command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return command


def _deliver(picture: Picture, outputs: Outputs, as_json: bool) -> None:
    """Write the picture and its data, and say what they show."""
    write_outputs(picture, outputs)
    texts = write_texts(picture, outputs.paths[0].parent)
    if as_json:
        files = to_plain({"figure": outputs.picture, "csv": outputs.data})
        print_json(files | {"written": [str(path) for path in texts]} | dict(picture.summary))
        return
    say(picture.caption)
    for path in (*outputs.paths, *texts):
        say(f"written: {path}")


@contextmanager
def _opened_table(path: Path) -> Iterator[Table]:
    """The table, refused where other code built it: what it holds and what is computed now would not fit together."""
    from precompute.builder.code_fingerprint import code_fingerprint

    with Table.open(path, code_fingerprint=code_fingerprint()) as table:
        yield table


@picture_command
def state(
    table_path: options.TableArgument,
    felt: options.FeltFingers,
    quiet: options.QuietFingers = "",
    level: options.Level = _DEFAULT_LEVEL,
    over_time: Annotated[bool, Option("--over-time", help="Draw how it builds up from rest.")] = False,
) -> Picture:
    """Draw a drive under some fingers: along the bar, or over time.

    The figure shows the drive that a run solves for these fingers, under the fingers that it may meet, against the
    detection threshold. The rise time lasts until every felt finger has 90 % of its predicted vibration.
    """
    with _opened_table(table_path) as table:
        from tactable.explain.placed_drive import designer_of
        from tactable.figures.course import plot_course
        from tactable.figures.state_picture import plot_state, solved_drive

        played = solved_drive(
            designer_of(table), options.read_placement(table.device, felt, quiet), options.read_level(level)
        )
        return plot_course(played) if over_time else plot_state(played)


@picture_command
def factor(
    table_path: options.TableArgument,
    zones: Annotated[str, Option(help="Zones whose common share is drawn, such as I,III; default: each.")] = "",
    amplitudes: Annotated[str, Option(help="Amplitudes of the two actuators, fractions of full scale.")] = "1,1",
    pair: Annotated[str, Option(help="Names of two actuators; default: the first two.")] = "",
) -> Picture:
    """Draw the localized factor over the frequencies of two actuators.

    The localized factor is the share of the bar's vibration that the named zones have.
    """
    with _opened_table(table_path) as table:
        from tactable.figures.factor import pair_drive, plot_factor

        drive = pair_drive(table.device, options.names_in(pair), options.read_numbers("--amplitudes", amplitudes))
        named = [options.read_zones("--zones", zones)] if zones else [[zone.name] for zone in table.device.zones]
        return plot_factor(table, named, drive)


@picture_command
def click(
    table_path: options.TableArgument,
    felt: options.FeltFingers,
    quiet: options.QuietFingers = "",
    level: options.Level = "full",
) -> Picture:
    """Draw one click: its waveform and what each finger feels.

    It is the table's click of the nearest places, or is solved where the table has none. The figure shows the
    acceleration under each finger at its position, and its spread over sampled plants that the click was not optimised
    over.
    """
    from engine.table.clicks import played_at

    with _opened_table(table_path) as table:
        from tactable.explain.click_source import ClickSource
        from tactable.figures.click_picture import plot_click

        source, placement = ClickSource(table), options.read_placement(table.device, felt, quiet)
        return plot_click(source, played_at(source.click_of(placement), options.read_level(level)), placement)


@picture_command
def response(
    device_name: options.DeviceArgument,
    drives: options.Frequencies = "",
    measured_path: Annotated[
        Path | None, Option("--measured", help="Draw these readings and their drives (tables/MEASUREMENTS.md).")
    ] = None,
    sensor_mass: options.SensorMass = "0 g",
    by_zone: Annotated[bool, Option("--by-zone", help="Draw up to four drives, with factors by zone.")] = False,
    change: options.Change = None,
) -> Picture:
    """Draw the acceleration over the surface of one or more drives.

    The actuators are at full scale. Measured readings are drawn beside the model where there are any. With --by-zone
    all drives share a panel, and another has the localized factor of each zone.
    """
    from precompute.measurements.measurement_file import read_measurements
    from precompute.measurements.types import lay_out
    from precompute.predict.untouched import BarDrive
    from tactable.figures.response_picture import plot_response
    from tactable.figures.zones import plot_zones

    device = _changed(device_name, change)
    mass_kg = options.read_option("--sensor-mass", sensor_mass, "kg")
    if bool(drives) == (measured_path is not None):
        raise options.OptionError("give --drives, as --drives '150,130', or --measured FILE, which has its own")
    if by_zone:
        if measured_path is not None:
            raise options.OptionError("--by-zone: give --drives; readings have no localized factors")
        each_hz = np.array(options.read_drives(drives, device))
        drawn = [BarDrive("", np.nan_to_num(hz), np.where(np.isnan(hz), 0, 1).astype(np.complex128)) for hz in each_hz]
        return plot_zones(device, drawn)
    if measured_path is None:
        layout = lay_out(np.array(options.read_drives(drives, device)), np.zeros(1), mass_kg)
    else:
        layout = read_measurements(measured_path, device, mass_kg)
    return plot_response(device, layout, has_readings=measured_path is not None)


@picture_command
def optimum(
    device_name: options.DeviceArgument,
    zone_names: Annotated[str, Option("--zones", help="Zones to vibrate, such as I,III,V.")],
    change: options.Change = None,
) -> Picture:
    """Draw the drives of greatest localized factor of some zones.

    The bar is untouched, as in the paper's equation (11).
    """
    from tactable.figures.zones import plot_optimum

    return plot_optimum(_changed(device_name, change), options.read_zones("--zones", zone_names))


@picture_command
def reach(device_name: options.DeviceArgument, change: options.Change = None) -> Picture:
    """Draw the greatest acceleration and level of each place of the bar.

    Places that no drive moves are dead zones.
    """
    from tactable.figures.reach_picture import plot_reach

    return plot_reach(_changed(device_name, change))


def _changed(device_name: str, change: list[str] | None) -> Device:
    """The device; where it is changed, its name says so."""
    from precompute.measurements.parameters import with_changes

    device = find_device(device_name)
    if not change:
        return device
    return replace(with_changes(device, options.read_changes(change, device)), name=f"{device.name}, changed")


@picture_command
def placement(
    device_name: options.DeviceArgument,
    progress: Progress,
    actuators: Annotated[str, Option(help=f"Numbers of actuators, up to {_MOST_ACTUATORS}.")] = "2,3,4",
    level_db: StudiedLevel = 20.0,
    most: Annotated[int, Option(min=3, max=100_000, help="Placements to screen for each number.")] = 300,
    workers: options.Workers = None,
    as_json: options.AsJson = False,
) -> Picture:
    """Search where actuators give the best worst contrast.

    Beside the picture it writes the device file of the best placement of each number of actuators. The worst
    contrast is that of one felt and one quiet finger in the least favourable zones. A search, not a proof.
    """
    from precompute.parallel.pool import WorkerPool
    from precompute.studies.placement_search import placed_text, search_placement
    from tactable.figures.placement_picture import plot_placement

    device, counts = find_device(device_name), options.read_counts("--actuators", actuators, 1, _MOST_ACTUATORS)
    if len(device.zones) < 2:
        raise options.OptionError(f"{device.name}: two fingers need two zones, it has {len(device.zones)}")
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
    device_name: options.DeviceArgument,
    progress: Progress,
    zones: Annotated[str, Option(help=f"Numbers of equal zones, 2 to {_MOST_ZONES}.")] = "2,3,4,5,6,8",
    placements: Annotated[
        str,
        Option(
            "--at",
            help="Positions of actuators in % of the bar, or of a plate's sides as 10x15, placements separated by ;. "
            "Default: the device's, and 1, 3 and 4 evenly spaced.",
        ),
    ] = "",
    level_db: StudiedLevel = 20.0,
    workers: options.Workers = None,
) -> Picture:
    """Study how narrow zones can be with a number of actuators.

    The figure shows the worst contrast of two fingers, and the localized factor of the worst zone.
    """
    from precompute.parallel.pool import WorkerPool
    from precompute.studies.placement_search import even_places, own_places, study_resolution
    from tactable.figures.resolution_picture import plot_resolution

    device, counts = find_device(device_name), options.read_counts("--zones", zones, 2, _MOST_ZONES)
    if placements:
        at_m = _read_placements(device, placements)
    else:
        own = own_places(device)
        at_m = sorted([own, *(even_places(device, n) for n in (1, 3, 4) if n != len(own))], key=len)
    with WorkerPool(_helpers(workers)) as pool:
        found = study_resolution(device, at_m, counts, level_db, partial(progress, "zones"), pool)
    return plot_resolution(device, found, level_db)


@picture_command
def robustness(
    device_name: options.DeviceArgument,
    progress: Progress,
    plants: Annotated[int, Option(min=2, max=10_000, help="Fresh plants of each of 50 placements and rows.")] = 200,
) -> Picture:
    """Study what clicks keep on bars and fingers that differ from the model.

    Clicks for two fingers are played on simulated bars with one thing changed a row. The figure shows in how many
    placements the felt finger still has 14 dB, and the quiet one at most 1 or 6 dB.
    """
    from precompute.parallel.pool import WorkerPool
    from precompute.studies.robustness import CHANGES, PLACEMENTS, SETS, study_robustness
    from tactable.figures.resolution_picture import plot_robustness

    device = find_device(device_name)
    made_for = [device.with_values({"spread": name}) for name in SETS]
    changes = [change for change in CHANGES if device.surface.kind == "bar" or not change.clamp_m]
    with WorkerPool(_helpers(None)) as pool:
        found = study_robustness(made_for, changes, plants, PLACEMENTS, partial(progress, "plants"), pool)
    return plot_robustness(device, changes, dict(zip(SETS, found, strict=True)), plants, PLACEMENTS)


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
            at_m = {read_point_on(f"{each} %", device.surface.corner_m) for each in options.names_in(part)}
        except QuantityError as error:
            raise options.OptionError(f"--at {text!r}: {error}") from None
        if not at_m or len(at_m) < len(options.names_in(part)):
            raise options.OptionError(
                f"--at {text!r}: {part!r}: expected different places in %, as 16,97.7 or 10x15,90x85"
            )
        found.append(tuple(sorted(at_m, key=order_of)))
    return found
