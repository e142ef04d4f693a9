"""Read a file of measurements in the format that its ending names."""

import stat
from pathlib import Path

from base.files import replace_file
from engine.device import Device
from engine.device.toml_table import read_text
from precompute.measurements.csv import parse_csv, write_csv
from precompute.measurements.types import MeasurementError, Measurements

MOST_BYTES = 100_000_000  # a million rows of CSV, where a fit takes 10 000 readings at most
_NETCDF, _UNIVERSAL = (".nc", ".nc4"), (".uff", ".unv", ".uf")


def read_measurements(path: Path | str, device: Device, sensor_mass_kg: float = 0.0) -> Measurements:
    """Read CSV, NetCDF or a universal file; `sensor_mass_kg` applies where the file does not state one.

    Raises MeasurementError; OSError if the file does not exist.
    """
    path = Path(path)
    check_file(path)
    ending = check_ending(path)
    if ending == ".csv":
        return parse_csv(read_text(path, MeasurementError), device, sensor_mass_kg, str(path))
    if ending in _NETCDF:
        from precompute.measurements.netcdf import read_netcdf

        return read_netcdf(path, device, sensor_mass_kg)
    from precompute.measurements.uff import read_uff

    return read_uff(path, device, sensor_mass_kg)


def write_measurements(path: Path, measurements: Measurements, device: Device, comment: str) -> None:
    """Write measurements in the format that the ending names; `comment` names their source. Raises MeasurementError."""
    ending = check_ending(path)
    if measurements.force_m is not None:
        raise MeasurementError(f"{path}: responses per newton are read, not written; keep the file that they came from")
    with replace_file(path) as partial:
        if ending == ".csv":
            partial.write_text(write_csv(measurements, device, comment), encoding="utf-8")
        elif ending in _NETCDF:
            from precompute.measurements.netcdf import write_netcdf

            write_netcdf(partial, measurements, device, comment)
        else:
            from precompute.measurements.uff import write_uff

            write_uff(partial, measurements, device, comment)


def check_file(path: Path) -> None:
    """Raise MeasurementError for what is no file of measurements by its name, kind or size, before a byte is read.

    A pipe would be waited for, and a device never ends. Raises OSError if the file does not exist.
    """
    check_ending(path)
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        raise MeasurementError(f"{path}: is not a plain file; write the measurements into one")
    if status.st_size > MOST_BYTES:
        raise MeasurementError(
            f"{path}: has {status.st_size / 1e6:.3g} MB, expected at most {MOST_BYTES / 1e6:.0f} MB: "
            "fewer measurements suffice"
        )


def check_ending(path: Path) -> str:
    """The ending of a file of measurements; raises MeasurementError for one that names no format."""
    ending = path.suffix.lower()
    if ending not in (".csv", *_NETCDF, *_UNIVERSAL):
        known = ", ".join((".csv", *_NETCDF, *_UNIVERSAL))
        raise MeasurementError(f"{path}: measurements end in {known}; choose one of them")
    return ending
