"""CSV files of measurements with units in the header (tables/MEASUREMENTS.md), read and written."""

import csv
import io

import numpy as np

from base.arrays import Points
from engine.device import Device
from precompute.measurements.columns import OPTIONAL, SIMULATED, assemble_measurements, column_names, split_places
from precompute.measurements.sheet import Sheet, read_columns, read_sheet, wrong_form
from precompute.measurements.types import Kind, MeasurementError, Measurements
from precompute.measurements.wide import read_wide


def parse_csv(text: str, device: Device, sensor_mass_kg: float, source: str) -> Measurements:
    """Read CSV text with one reading a row, or a wide table.

    Raises MeasurementError, which names the row and the column, or the form of a file that holds no readings.
    """
    sheet = read_sheet(text, source, "position (mm),peak acceleration (m/s^2)")
    return measurements_of(sheet, device, sensor_mass_kg, source)


def measurements_of(sheet: Sheet, device: Device, sensor_mass_kg: float, source: str) -> Measurements:
    """The measurements of a plain or a wide table. Raises MeasurementError."""
    form = wrong_form(sheet.titles, device)
    if form is not None:
        raise MeasurementError(f"{source}: {form}")
    columns, labels = read_wide(sheet, device, source) or (
        read_columns(sheet, column_names(device), lambda name: name.startswith(OPTIONAL), device, source),
        sheet.labels,
    )
    return assemble_measurements(
        columns, device, sensor_mass_kg, source, lambda row: labels[row], is_simulated=sheet.is_simulated
    )


def write_csv(measurements: Measurements, device: Device, comment: str) -> str:
    """CSV text of the measurements; `comment` names their source. Readings have six digits, other columns twelve."""
    out = io.StringIO()
    out.writelines(f"# {line}\n" for line in comment.splitlines())
    if measurements.is_simulated and SIMULATED not in comment:
        out.write(f"# {SIMULATED}\n")
    is_still, read = measurements.amplitude == 0, measurements.acceleration
    columns = _places(measurements.position_m, device, "position")
    moved = {"frequency": ("Hz", measurements.frequency_hz), "amplitude": ("%", 100 * abs(measurements.amplitude))}
    if (measurements.amplitude.imag != 0).any():
        moved["phase"] = "rad", np.angle(measurements.amplitude)
    for key, (unit, values) in moved.items():
        for index, actuator in enumerate(device.actuators):
            own = zip(values[:, index], is_still[:, index], strict=True)
            columns[f"{key} {actuator.name} ({unit})"] = ["" if still else _exact(value) for value, still in own]
    columns["sensor mass (g)"] = [_exact(1e3 * mass_kg) for mass_kg in measurements.sensor_mass_kg]
    if not np.isnan(measurements.finger_m).all():
        columns |= _places(measurements.finger_m, device, "finger position")
    is_peak = measurements.kind is Kind.PEAK
    parts = (
        {"peak acceleration": read.real}
        if is_peak
        else {"acceleration real": read.real, "acceleration imaginary": read.imag}
    )
    columns |= {f"{name} (m/s^2)": [f"{value:.6g}" for value in values] for name, values in parts.items()}
    writer = csv.writer(out, lineterminator="\n")
    writer.writerows([columns.keys(), *zip(*columns.values(), strict=True)])
    return out.getvalue()


def _places(place_m: Points, device: Device, name: str) -> dict[str, list[str]]:
    """Columns of places in mm, empty in a row without one."""
    sides = split_places(device, name, place_m).items()
    return {f"{key} (mm)": ["" if np.isnan(each) else _exact(1e3 * each) for each in part] for key, part in sides}


def _exact(value: float) -> str:
    return f"{value:.12g}"
