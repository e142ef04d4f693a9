"""CSV files of measurements with units in the header (tables/MEASUREMENTS.md), read and written."""

import csv
import io

import numpy as np

from base.points import parts_of
from engine.device import Device
from precompute.measurements.columns import SIMULATED, assemble_measurements, column_names, may_be_empty, split_places
from precompute.measurements.csv_form import wrong_form
from precompute.measurements.sheet import Sheet, read_columns, read_sheet
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
        read_columns(sheet, column_names(device), may_be_empty, device, source),
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
    names = [actuator.name for actuator in device.actuators]
    is_peak = measurements.kind is Kind.PEAK
    is_touched = not np.isnan(measurements.finger_m).all()
    fingers_m = split_places(device, "finger position", measurements.finger_m) if is_touched else {}
    has_phase = bool((measurements.amplitude.imag != 0).any())
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(
        [
            *(f"{name} (mm)" for name in split_places(device, "position", measurements.position_m)),
            *(f"frequency {name} (Hz)" for name in names),
            *(f"amplitude {name} (%)" for name in names),
            *(f"phase {name} (rad)" for name in names if has_phase),
            "sensor mass (g)",
            *(f"{name} (mm)" for name in fingers_m),
            *(["peak acceleration (m/s^2)"] if is_peak else _PARTS),
        ]
    )
    for i, value in enumerate(measurements.acceleration):
        drive = measurements.amplitude[i]
        is_still = drive == 0
        writer.writerow(
            [
                *(_exact(1e3 * part_m) for part_m in parts_of(measurements.position_m[i])),
                *(
                    "" if still else _exact(hz)
                    for hz, still in zip(measurements.frequency_hz[i], is_still, strict=True)
                ),
                *("" if still else _exact(100 * abs(a)) for a, still in zip(drive, is_still, strict=True)),
                *("" if still else _exact(np.angle(a)) for a, still in zip(drive, is_still, strict=True) if has_phase),
                _exact(1e3 * measurements.sensor_mass_kg[i]),
                *("" if np.isnan(column[i]) else _exact(1e3 * column[i]) for column in fingers_m.values()),
                *([f"{value.real:.6g}"] if is_peak else [f"{value.real:.6g}", f"{value.imag:.6g}"]),
            ]
        )
    return out.getvalue()


_PARTS = ["acceleration real (m/s^2)", "acceleration imaginary (m/s^2)"]


def _exact(value: float) -> str:
    return f"{value:.12g}"
