"""A file of measurements, in whatever form its name says, to measurements."""

from pathlib import Path

from engine.device import Device
from engine.device.toml_table import read_text
from precompute.measurements.csv import parse_csv
from precompute.measurements.types import MeasurementError, Measurements

_NETCDF, _UNIVERSAL = (".nc", ".nc4"), (".uff", ".unv", ".uf")


def read_measurements(path: Path | str, device: Device, sensor_mass_kg: float = 0.0) -> Measurements:
    """CSV, NetCDF or a universal file, by its ending. `sensor_mass_kg` is for files that do not say it.

    Raises MeasurementError; OSError when there is no such file.
    """
    path = Path(path)
    ending = path.suffix.lower()
    if ending == ".csv":
        return parse_csv(read_text(path, MeasurementError), device, sensor_mass_kg, str(path))
    if ending not in _NETCDF + _UNIVERSAL:
        known = ", ".join((".csv", *_NETCDF, *_UNIVERSAL))
        raise MeasurementError(f"{path}: measurements end in {known}; choose one of them")
    path.stat()  # no such file: OSError, as for any other
    if ending in _NETCDF:
        from precompute.measurements.netcdf import read_netcdf

        return read_netcdf(path, device, sensor_mass_kg)
    from precompute.measurements.uff import read_uff

    return read_uff(path, device, sensor_mass_kg)
