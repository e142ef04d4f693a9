"""CSV files of measurements with units in the header (tables/MEASUREMENTS.md), read and written."""

import csv
import difflib
import io
import re
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from engine.device import Device
from engine.device.quantity import QuantityError
from precompute.measurements.columns import SIMULATED, assemble_measurements, column_names, may_be_empty, read_column
from precompute.measurements.csv_form import wrong_form
from precompute.measurements.types import Kind, MeasurementError, Measurements

MOST_ROWS = 100_000
"""Twice the rows of every frequency at every place, which is the most that a build reads."""
_HEADER = re.compile(r"(.+?) ?\(((?:[^()]|\([^()]*\))*)\)(/\w+)?")


def parse_csv(text: str, device: Device, sensor_mass_kg: float, source: str) -> Measurements:
    """Read CSV text with one reading a row.

    Raises MeasurementError, which names the row and the column, or the form of a file that is not one reading a row.
    """
    lines = split_lines(text, source, "position (mm),peak acceleration (m/s^2)")
    form = wrong_form([line for _, line in lines], device)
    if form is not None:
        raise MeasurementError(f"{source}: {form}")
    columns, numbers = read_columns(lines, column_names(device), may_be_empty, device, source)
    return assemble_measurements(
        columns, device, sensor_mass_kg, source, lambda row: f"row {numbers[row]}", is_simulated=says_simulated(text)
    )


def split_lines(text: str, source: str, example: str) -> list[tuple[int, str]]:
    """Header and rows with their line numbers: lines that begin with # are comments, a byte order mark is passed over.

    Raises MeasurementError for a text without a line, and for too many rows.
    """
    text = text.removeprefix("\ufeff")
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip() and line[0] != "#"]
    if lines and lines[0][1].strip() == "sep=,":
        del lines[0]  # what spreadsheets are told
    if not lines:
        raise MeasurementError(f"{source}: is empty; expected a header such as {example}")
    if len(lines) > MOST_ROWS + 1:
        raise MeasurementError(
            f"{source}: has {len(lines) - 1} rows; expected at most {MOST_ROWS}: take the mean of repeated readings"
        )
    return lines


def says_simulated(text: str) -> bool:
    """Whether a comment marks the content as SIMULATED."""
    return any(line.startswith("#") and SIMULATED in line for line in text.splitlines())


def read_columns(
    lines: Sequence[tuple[int, str]],
    known: Mapping[str, str],
    is_optional: Callable[[str], bool],
    device: Device,
    source: str,
) -> tuple[dict[str, NDArray[np.float64]], list[int]]:
    """Columns (row,) in SI by name, NaN where empty, and the line number of each row.

    known: SI unit by the name of a column. Raises MeasurementError, which names the row and the column.
    """
    # Line by line: a quotation mark that is not closed would join rows.
    header, *cells = (_read_row(line, source, number) for number, line in lines)
    numbers = [number for number, _ in lines[1:]]
    columns: dict[str, NDArray[np.float64]] = {}
    for index, title in enumerate(header):
        name, scale = _read_title(title, known, device, source, index)
        if name in columns:
            raise MeasurementError(f"{source}: column {index + 1}: {title!r}: is there twice")
        empty_ok = is_optional(name)
        columns[name] = scale * np.array(
            [
                _read_cell(row, index, title, empty_ok, len(header), source, number)
                for row, number in zip(cells, numbers, strict=True)
            ]
        )
    return columns, numbers


def _read_row(line: str, source: str, number: int) -> list[str]:
    try:
        return next(csv.reader([line], strict=True))
    except csv.Error as error:
        remedy = "close its quotation marks" if '"' in line else "correct it"
        raise MeasurementError(f"{source}: row {number}: is no row of numbers ({error}); {remedy}") from None


def _read_title(title: str, known: Mapping[str, str], device: Device, source: str, index: int) -> tuple[str, float]:
    """Name of a column and the factor that makes its values SI."""
    match = _HEADER.fullmatch(title.strip())
    where = f"{source}: column {index + 1}: {title!r}"
    if match is None:
        raise MeasurementError(f"{where}: has no unit; expected a header such as position (mm)")
    name, unit = match[1].strip(), match[2].strip() if match[3] is None else f"({match[2]}){match[3]}"
    if name not in known:
        near = difflib.get_close_matches(name, known, 1)
        hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(known)}"
        raise MeasurementError(f"{where}: unknown column; {hint}")
    if name.endswith("position") and unit == "%":
        return name, device.bar.length_m / 100
    try:
        return read_column(name, unit, known[name])
    except QuantityError as error:
        raise MeasurementError(f"{where}: {error}") from None


def _read_cell(
    row: Sequence[str], index: int, title: str, empty_ok: bool, width: int, source: str, number: int
) -> float:
    if len(row) != width:
        raise MeasurementError(f"{source}: row {number}: has {len(row)} cells, the header {width}; make them equal")
    cell = row[index].strip()
    if not cell and empty_ok:
        return np.nan
    try:
        value = float(cell)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise MeasurementError(f"{source}: row {number}, column {title.strip()!r}: {cell!r}: expected a finite number")
    return value


def write_csv(measurements: Measurements, device: Device, comment: str) -> str:
    """CSV text of the measurements; `comment` names their source. Readings have six digits, other columns twelve."""
    out = io.StringIO()
    out.writelines(f"# {line}\n" for line in comment.splitlines())
    if measurements.is_simulated and SIMULATED not in comment:
        out.write(f"# {SIMULATED}\n")
    names = [actuator.name for actuator in device.actuators]
    has_finger, is_peak = not np.isnan(measurements.finger_m).all(), measurements.kind is Kind.PEAK
    has_phase = bool((measurements.amplitude.imag != 0).any())
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(
        [
            "position (mm)",
            *(f"frequency {name} (Hz)" for name in names),
            *(f"amplitude {name} (%)" for name in names),
            *(f"phase {name} (rad)" for name in names if has_phase),
            "sensor mass (g)",
            *(["finger position (mm)"] if has_finger else []),
            *(["peak acceleration (m/s^2)"] if is_peak else _PARTS),
        ]
    )
    for i, value in enumerate(measurements.acceleration):
        drive, finger_m = measurements.amplitude[i], measurements.finger_m[i]
        is_still = drive == 0
        writer.writerow(
            [
                _exact(1e3 * measurements.position_m[i]),
                *(
                    "" if still else _exact(hz)
                    for hz, still in zip(measurements.frequency_hz[i], is_still, strict=True)
                ),
                *("" if still else _exact(100 * abs(a)) for a, still in zip(drive, is_still, strict=True)),
                *("" if still else _exact(np.angle(a)) for a, still in zip(drive, is_still, strict=True) if has_phase),
                _exact(1e3 * measurements.sensor_mass_kg[i]),
                *([] if not has_finger else ["" if np.isnan(finger_m) else _exact(1e3 * finger_m)]),
                *([f"{value.real:.6g}"] if is_peak else [f"{value.real:.6g}", f"{value.imag:.6g}"]),
            ]
        )
    return out.getvalue()


_PARTS = ["acceleration real (m/s^2)", "acceleration imaginary (m/s^2)"]


def _exact(value: float) -> str:
    return f"{value:.12g}"
