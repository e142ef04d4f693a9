"""NetCDF files of measurements (tables/MEASUREMENTS.md), read and written with xarray.

Others write these files. HDF5 would follow their links and external storage to any file of this machine, or to a pipe
that never ends, and a small file may declare an array that fills the memory. So both are refused before xarray opens
the file.
"""

import re
import warnings
from pathlib import Path

import h5py
import numpy as np
import xarray
from numpy.typing import NDArray

from engine.device import Device
from engine.device.quantity import QuantityError
from precompute.measurements.columns import SIMULATED, assemble_measurements, column_names, may_be_empty, unit_scale
from precompute.measurements.types import Kind, MeasurementError, Measurements

_MOST_BYTES = 1 << 26
"""Of one array: eight million readings."""
_UDUNITS_FACTOR = re.compile(r"([A-Za-zµ%]+)(-?\d)?")


def read_netcdf(path: Path, device: Device, sensor_mass_kg: float) -> Measurements:
    """Read variables over `measurement`, or over `measurement` and `actuator`. Raises MeasurementError."""
    try:
        _check_storage(path)
        with warnings.catch_warnings():
            warnings.simplefilter("error", xarray.SerializationWarning)  # such as of several fill values
            dataset = xarray.load_dataset(path, engine="h5netcdf", phony_dims="sort")
    except MeasurementError:
        raise
    except Exception as error:  # of a damaged file h5py and xarray raise almost every kind
        raise MeasurementError(f"{path}: not a NetCDF-4 file: {error}") from error
    known = column_names(device)
    names = [actuator.name for actuator in device.actuators]
    columns: dict[str, NDArray[np.float64]] = {}
    for name, variable in dataset.data_vars.items():
        title = str(name).replace("_", " ")
        if "actuator" in variable.dims:
            if "actuator" not in dataset.coords or [str(n) for n in dataset.actuator.values] != names:
                raise MeasurementError(
                    f"{path}: actuator: expected a coordinate with {', '.join(names)}, in this order"
                )
            parts = {f"{title} {n}": variable.isel(actuator=i) for i, n in enumerate(names)}
        else:
            parts = {title: variable}
        for column, values in parts.items():
            if column not in known or values.dims != ("measurement",):
                listed = ", ".join(key.replace(" ", "_") for key in known)
                raise MeasurementError(f"{path}: {name}: unknown variable; over 'measurement' are known {listed}")
            columns[column] = _read_column(values, column, known[column], path, str(name))
    is_simulated = any(SIMULATED in str(value) for value in dataset.attrs.values())
    return assemble_measurements(
        columns, device, sensor_mass_kg, str(path), lambda row: f"measurement {row}", is_simulated=is_simulated
    )


def write_netcdf(path: Path, measurements: Measurements, device: Device, comment: str) -> None:
    """Write measurements as `read_netcdf` reads them; `comment` names their source."""
    row, each = ("measurement",), ("measurement", "actuator")
    columns: dict[str, tuple[tuple[str, ...], NDArray[np.float64], str]] = {
        "position": (row, measurements.position_m, "m"),
        "frequency": (each, measurements.frequency_hz, "Hz"),
        "amplitude": (each, np.abs(measurements.amplitude), "1"),
        "phase": (each, np.angle(measurements.amplitude), "rad"),
        "sensor_mass": (row, measurements.sensor_mass_kg, "kg"),
        "finger_position": (row, measurements.finger_m, "m"),
    }
    acceleration = measurements.acceleration
    if measurements.kind is Kind.PEAK:
        columns["peak_acceleration"] = (row, acceleration.real, "m s-2")
    else:
        columns["acceleration_real"] = (row, acceleration.real, "m s-2")
        columns["acceleration_imaginary"] = (row, acceleration.imag, "m s-2")
    dataset = xarray.Dataset(
        {name: (dimensions, values, {"units": unit}) for name, (dimensions, values, unit) in columns.items()},
        coords={"actuator": [actuator.name for actuator in device.actuators]},
        attrs={"comment": comment, **({"origin": SIMULATED} if measurements.is_simulated else {})},
    )
    dataset.to_netcdf(path, engine="h5netcdf")


def _check_storage(path: Path) -> None:
    """Raise MeasurementError for an array that lies outside the file or is too large."""
    with h5py.File(path) as file:
        for name in file:
            if not isinstance(file.get(name, getlink=True), h5py.HardLink):
                raise MeasurementError(f"{path}: {name}: is a link, which is not followed; write the values themselves")
            array = file[name]
            if not isinstance(array, h5py.Dataset):
                continue
            if array.is_virtual or array.id.get_create_plist().get_external_count():
                raise MeasurementError(f"{path}: {name}: its values are in another file; write them into this one")
            if array.shape is not None and array.nbytes > _MOST_BYTES:
                raise MeasurementError(
                    f"{path}: {name}: has shape {array.shape}, {array.nbytes / 1e6:.3g} MB; expected at most "
                    f"{_MOST_BYTES / 1e6:.0f} MB: fewer measurements suffice"
                )


def _read_column(values: xarray.DataArray, column: str, unit: str, path: Path, name: str) -> NDArray[np.float64]:
    if values.dtype.kind == "c":
        raise MeasurementError(f"{path}: {name}: has complex values; write real and imaginary part apart")
    written = values.attrs.get("units")
    if not isinstance(written, str):
        raise MeasurementError(f"{path}: {name}: has no attribute 'units'; expected such as {unit or '1'!r}")
    try:
        scale = unit_scale(_from_udunits(written), unit)
        out = scale * np.asarray(values.values, dtype=np.float64)
    except (QuantityError, TypeError, ValueError) as error:
        raise MeasurementError(f"{path}: {name}: {error}") from None
    bad = ~np.isfinite(out) & (True if not may_be_empty(column) else ~np.isnan(out))
    if bad.any():
        where = int(np.argmax(bad))
        raise MeasurementError(f"{path}: measurement {where}: {name}: {out[where]}: expected a finite number")
    return out


def _from_udunits(text: str) -> str:
    """Convert the UDUNITS notation 'm s-2' to 'm*s^-2'; text without spaces stays as it is."""
    factors = text.split()
    if len(factors) < 2 or not all(_UDUNITS_FACTOR.fullmatch(factor) for factor in factors):
        return text
    return "*".join(_UDUNITS_FACTOR.sub(lambda m: m[1] + (f"^{m[2]}" if m[2] else ""), factor) for factor in factors)
