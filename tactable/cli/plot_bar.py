"""The commands around figures of a bar without a table: responses, drives by zone, the optimum, dead zones."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from threadpoolctl import threadpool_limits

from engine.device import Device
from tactable.cli.plot import AsJson, CsvPath, Output, deliver, named_zones
from tactable.figures.file import FigureError, check_paths
from tactable.shipped import find_device

DeviceName = Annotated[str, typer.Argument(metavar="DEVICE", help="A device file, or a shipped name.")]
Change = Annotated[
    list[str] | None, typer.Option(metavar="NAME=VALUE", help="What is different from the device. Repeat.")
]
Drives = Annotated[str, typer.Option(help="Frequencies of the actuators in Hz, drives parted by ;, - for still.")]


def register(plot: typer.Typer) -> None:
    """Put the commands of this module into `plot`."""
    plot.command()(response)
    plot.command()(zones)
    plot.command()(optimum)
    plot.command()(reach)


def response(
    device_name: DeviceName,
    drives: Drives = "",
    measured_path: Annotated[
        Path | None, typer.Option("--measured", help="Points to draw with their drives (tables/MEASUREMENTS.md).")
    ] = None,
    sensor_mass: Annotated[
        str, typer.Option("--sensor-mass", help="Of the accelerometer, where the file has none.")
    ] = "0 g",
    change: Change = None,
    output: Output = Path("response.png"),
    csv_path: CsvPath = None,
    as_json: AsJson = False,
) -> None:
    """Acceleration along the bar of one or more drives at full scale, with measured points if there are any."""
    from precompute.measurements import lay_out, read_measurements
    from tactable.cli.calibrate_options import read_drives, read_option
    from tactable.figures.response import plot_response

    check_paths(output, csv_path)
    device = _changed(device_name, change)
    mass_kg = read_option("--sensor-mass", sensor_mass, "kg")
    if bool(drives) == (measured_path is not None):
        raise FigureError(
            "what to draw: give --drives, such as --drives '150,130', or --measured FILE, which has its own"
        )
    if measured_path is None:
        layout = lay_out(np.array(read_drives(drives, device)), np.zeros(1), mass_kg)
    else:
        layout = read_measurements(measured_path, device, mass_kg)
    with threadpool_limits(1, "blas"):
        deliver(plot_response(device, layout, has_readings=measured_path is not None), output, csv_path, as_json)


def zones(
    device_name: DeviceName,
    drives: Drives,
    change: Change = None,
    output: Output = Path("zones.png"),
    csv_path: CsvPath = None,
    as_json: AsJson = False,
) -> None:
    """Localized factor and acceleration by zone of up to four drives at full scale, on the untouched bar."""
    from precompute.entries.untouched import BarDrive
    from tactable.cli.calibrate_options import read_drives
    from tactable.figures.zones import plot_zones

    check_paths(output, csv_path)
    device = _changed(device_name, change)
    drives_hz = np.array(read_drives(drives, device))
    drawn = [BarDrive("", np.nan_to_num(hz), np.where(np.isnan(hz), 0, 1).astype(np.complex128)) for hz in drives_hz]
    with threadpool_limits(1, "blas"):
        deliver(plot_zones(device, drawn), output, csv_path, as_json)


def optimum(
    device_name: DeviceName,
    zone_names: Annotated[str, typer.Option("--zones", help="Zones to vibrate, such as I,III,V.")],
    change: Change = None,
    output: Output = Path("optimum.png"),
    csv_path: CsvPath = None,
    as_json: AsJson = False,
) -> None:
    """The drives of greatest localized factor of some zones on the untouched bar, as the paper's equation (11) asks."""
    from tactable.figures.zones import plot_optimum

    check_paths(output, csv_path)
    device = _changed(device_name, change)
    with threadpool_limits(1, "blas"):
        deliver(plot_optimum(device, named_zones("--zones", zone_names)), output, csv_path, as_json)


def reach(
    device_name: DeviceName,
    change: Change = None,
    output: Output = Path("reach.png"),
    csv_path: CsvPath = None,
    as_json: AsJson = False,
) -> None:
    """Dead zones: the greatest acceleration and level that each place of the bar can be given."""
    from tactable.figures.reach import plot_reach

    check_paths(output, csv_path)
    device = _changed(device_name, change)
    with threadpool_limits(1, "blas"):
        deliver(plot_reach(device), output, csv_path, as_json)


def _changed(device_name: str, change: list[str] | None) -> Device:
    """The device, and where something is different, with a name that says so."""
    from dataclasses import replace

    from precompute.measurements.parameters import with_changes
    from tactable.cli.calibrate_options import read_changes

    device = find_device(device_name)
    if not change:
        return device
    return replace(with_changes(device, read_changes(change, device)), name=f"{device.name}, changed")
