"""Read a file of measurements in the format that its ending names."""

from pathlib import Path

from engine.device import Device
from engine.device.toml_table import read_text
from precompute.measurements.csv import parse_csv
from precompute.measurements.types import MeasurementError, Measurements

_NETCDF, _UNIVERSAL = (".nc", ".nc4"), (".uff", ".unv", ".uf")


def read_measurements(path: Path | str, device: Device, sensor_mass_kg: float = 0.0) -> Measurements:
    """Read CSV, NetCDF or a universal file; `sensor_mass_kg` applies where the file does not state one.

    Raises MeasurementError; OSError if the file does not exist.
    """
    path = Path(path)
    ending = path.suffix.lower()
    if ending == ".csv":
        return parse_csv(read_text(path, MeasurementError), device, sensor_mass_kg, str(path))
    if ending not in _NETCDF + _UNIVERSAL:
        known = ", ".join((".csv", *_NETCDF, *_UNIVERSAL))
        raise MeasurementError(f"{path}: measurements end in {known}; choose one of them")
    path.stat()  # raises OSError where the file is missing, as the CSV branch does
    if ending in _NETCDF:
        from precompute.measurements.netcdf import read_netcdf

        return read_netcdf(path, device, sensor_mass_kg)
    from precompute.measurements.uff import read_uff

    return read_uff(path, device, sensor_mass_kg)
