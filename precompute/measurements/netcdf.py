"""NetCDF files of measurements (tables/MEASUREMENTS.md), as measurements and back; netcdf_content.py opens them."""

import io
from pathlib import Path

import numpy as np

from base.arrays import Array, Points
from engine.device import Device
from engine.device.quantity import QuantityError
from precompute.measurements.columns import (
    SIMULATED,
    assemble_measurements,
    column_names,
    may_be_empty,
    read_column,
    split_places,
)
from precompute.measurements.netcdf_content import Content, Variable, read_content
from precompute.measurements.types import Kind, MeasurementError, Measurements


def read_netcdf(path: Path, device: Device, sensor_mass_kg: float) -> Measurements:
    """Read variables over `measurement`, or over `measurement` and `actuator`. Raises MeasurementError.

    HDF5 parses the file in a child process: a damaged file ends that process, or is given up after its time.
    """
    return measurements_of(read_content(path), path, device, sensor_mass_kg)


def measurements_of(content: Content, path: Path, device: Device, sensor_mass_kg: float) -> Measurements:
    """The measurements that a file's arrays and labels are. Raises MeasurementError."""
    known = column_names(device)
    names = [actuator.name for actuator in device.actuators]
    columns: dict[str, Array] = {}
    for variable in content.variables:
        title = variable.name.replace("_", " ")
        dimensions, parts = variable.dimensions, {title: variable.values}
        if "actuator" in dimensions:
            if content.actuators is None or [*content.actuators] != names:
                raise MeasurementError(
                    f"{path}: actuator: expected a coordinate with {', '.join(names)}, in this order"
                )
            axis = dimensions.index("actuator")
            dimensions = (*dimensions[:axis], *dimensions[axis + 1 :])
            parts = {f"{title} {name}": np.take(variable.values, i, axis) for i, name in enumerate(names)}
        for column, values in parts.items():
            if column not in known or dimensions != ("measurement",):
                listed = ", ".join(key.replace(" ", "_") for key in known)
                raise MeasurementError(
                    f"{path}: {variable.name}: unknown variable; over 'measurement' are known {listed}"
                )
            name, read = _read_column(variable._replace(values=values), column, known[column], path)
            if name in columns:
                raise MeasurementError(f"{path}: {variable.name}: holds a {name.split()[0]}, which is there twice")
            columns[name] = read
    return assemble_measurements(
        columns, device, sensor_mass_kg, str(path), lambda row: f"measurement {row}", is_simulated=content.is_simulated
    )


def write_netcdf(path: Path, measurements: Measurements, device: Device, comment: str) -> None:
    """Write measurements as `read_netcdf` reads them; `comment` names their source."""
    import h5netcdf
    import h5py

    row, each = ("measurement",), ("measurement", "actuator")
    columns: dict[str, tuple[tuple[str, ...], Array, str]] = {
        **_places(device, "position", measurements.position_m),
        "frequency": (each, measurements.frequency_hz, "Hz"),
        "amplitude": (each, np.abs(measurements.amplitude), "1"),
        "phase": (each, np.angle(measurements.amplitude), "rad"),
        "sensor_mass": (row, measurements.sensor_mass_kg, "kg"),
        **_places(device, "finger position", measurements.finger_m),
    }
    acceleration = measurements.acceleration
    if measurements.kind is Kind.PEAK:
        columns["peak_acceleration"] = (row, acceleration.real, "m s-2")
    else:
        columns["acceleration_real"] = (row, acceleration.real, "m s-2")
        columns["acceleration_imaginary"] = (row, acceleration.imag, "m s-2")
    attributes = {"comment": comment, **({"origin": SIMULATED} if measurements.is_simulated else {})}
    # In memory first: HDF5 ends the process by a segmentation fault when it closes a file that the disk did not take.
    memory = io.BytesIO()
    with h5py.File(memory, "w", track_order=True) as inside, h5netcdf.File(inside, "w", track_order=True) as file:
        file.attrs.update(attributes)
        file.dimensions = {"measurement": len(measurements), "actuator": len(device.actuators)}
        names = np.array([actuator.name for actuator in device.actuators], dtype=object)
        file.create_variable("actuator", ("actuator",), h5py.string_dtype(), data=names)
        for name, (dimensions, values, unit) in columns.items():
            file.create_variable(name, dimensions, data=values).attrs["units"] = unit
    path.write_bytes(memory.getvalue())


def _places(device: Device, name: str, place_m: Points) -> dict[str, tuple[tuple[str, ...], Array, str]]:
    """Arrays of places by name, as they are written."""
    split = split_places(device, name, place_m)
    return {each.replace(" ", "_"): (("measurement",), part_m, "m") for each, part_m in split.items()}


def _read_column(variable: Variable, column: str, unit: str, path: Path) -> tuple[str, Array]:
    name, _, written, values = variable
    if values.dtype.kind == "c":
        raise MeasurementError(f"{path}: {name}: has complex values; write real and imaginary part apart")
    if written is None:
        raise MeasurementError(f"{path}: {name}: has no attribute 'units'; expected such as {unit or '1'!r}")
    try:
        found, scale = read_column(column, written, unit)
        out = scale * np.asarray(values, dtype=np.float64)
    except (QuantityError, TypeError, ValueError) as error:
        raise MeasurementError(f"{path}: {name}: {error}") from None
    bad = ~np.isfinite(out) & (True if not may_be_empty(column) else ~np.isnan(out))
    if bad.any():
        where = int(np.argmax(bad))
        raise MeasurementError(f"{path}: measurement {where}: {name}: {out[where]}: expected a finite number")
    return found, out
