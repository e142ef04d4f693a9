"""Text of cells in rows, as spreadsheets and programs write it, to columns of numbers by their headings.

Cells are separated by commas, semicolons or tabs, as a line `sep=` or else the header says; where commas do not
separate, they may be decimal points. Lines that begin with # are comments, but for a header that is one, as of NumPy.

Programs export time series and spectra in tables that look like measurements. Such a table fails at its first heading
for a reason that does not help, such as a missing unit. So its form is looked at first, and the remedy is said.
"""

import csv
import difflib
import re
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from base.arrays import Array
from engine.device import Device
from engine.device.quantity import QuantityError, read_number
from precompute.measurements.columns import SIMULATED, read_column, side_of, split_places
from precompute.measurements.types import MeasurementError

MOST_ROWS = 100_000  # twice the rows of every frequency at every place, which is the most that a build reads
_TOLD = re.compile(r'\s*"?sep=(\\t|[,;\t])"?\s*', re.IGNORECASE)
_TITLE = re.compile(r"(.+?) ?\(((?:[^()]|\([^()]*\))*)\)(/\w+)?")
_NUMBERS = re.compile(r"[-+\d.,eEij() ]*\d[-+\d.,eEij() ]*")
_DECIMAL_COMMA = re.compile(r"[-+\d., eEij()]*\d,\d[-+\d., eEij()]*")
_TIME = re.compile(r"(t|time|zeit|temps|timestamp|seconds?)\b.*", re.IGNORECASE)
_DENSITY = re.compile(r"\bpsd", re.IGNORECASE)
_DAMPING = re.compile(r"(modal )?damping|loss factor|q\b", re.IGNORECASE)
_SHOWN = 32  # enough to know a line again


class Sheet(NamedTuple):
    """Cells as text with decimal points, each row as long as the titles; errors name a row by its label."""

    titles: list[str]
    rows: list[list[str]]
    labels: list[str]
    is_simulated: bool


def read_sheet(text: str, source: str, example: str) -> Sheet:
    """Header and rows of a text; `example` is a header for errors. Raises MeasurementError, which names the row."""
    lines = [(n, line) for n, line in enumerate(text.removeprefix("\ufeff").splitlines(), 1) if line.strip(' ,;\t"')]
    told = _TOLD.fullmatch(lines[0][1]) if lines else None
    lines = lines[1:] if told else lines
    comments = [line.strip(' "') for _, line in lines if line.lstrip(' "').startswith("#")]
    lines = [(n, line) for n, line in lines if not line.lstrip(' "').startswith("#")]
    if not lines:
        raise MeasurementError(f"{source}: is empty; expected a header such as {example}")
    if len(lines) > MOST_ROWS + 1:
        raise MeasurementError(
            f"{source}: has {len(lines) - 1} rows; expected at most {MOST_ROWS}: take the mean of repeated readings"
        )
    header = re.sub('"[^"]*"', "", lines[0][1])
    separator = told[1].replace("\\t", "\t") if told else next((mark for mark in ";\t" if mark in header), ",")
    # Line by line: a quotation mark that is not closed would join rows.
    titles, *rows = (_read_row(line, separator, source, n) for n, line in lines)
    labels = [f"row {n}" for n, _ in lines[1:]]
    named = comments[-1].lstrip("# ").split(separator) if comments else []
    if all(map(_NUMBERS.fullmatch, titles)) and len(named) == len(titles):
        titles, rows, labels = [name.strip() for name in named], [titles, *rows], [f"row {lines[0][0]}", *labels]
    while titles and not titles[-1] and all(len(row) < len(titles) or not row[len(titles) - 1] for row in rows):
        titles, rows = titles[:-1], [row[: len(titles) - 1] for row in rows]  # a separator ends each line
    units = rows[0] if rows and len(rows[0]) == len(titles) else []
    if any(units) and not any(split_title(title)[1] for title in titles) and not any(map(_NUMBERS.fullmatch, units)):
        pairs = zip(titles, units, strict=True)  # the units have a line of their own
        titles = [f"{title} ({unit.strip('[]()')})" if unit else title for title, unit in pairs]
        rows, labels = rows[1:], labels[1:]
    sheet = Sheet(titles, rows, labels, any(SIMULATED in comment for comment in comments))
    return check_sheet(sheet, source, has_commas=separator == ",")


def check_sheet(sheet: Sheet, source: str, *, has_commas: bool) -> Sheet:
    """The sheet with decimal points; raises MeasurementError for a row of another length, and for points and commas."""
    for label, row in zip(sheet.labels, sheet.rows, strict=True):
        if len(row) != len(sheet.titles):
            raise MeasurementError(
                f"{source}: {label}: has {len(row)} cells, the header {len(sheet.titles)}; make them equal"
            )
    if has_commas or not any(_DECIMAL_COMMA.fullmatch(cell) for row in sheet.rows for cell in row):
        return sheet
    for label, row in zip(sheet.labels, sheet.rows, strict=True):
        if pointed := [cell for cell in row if "." in cell]:
            remedy = "write decimals with one of them, and nothing between thousands"
            raise MeasurementError(f"{source}: {label}: {pointed[0]!r}: has a point, other cells a comma; {remedy}")
    return sheet._replace(rows=[[cell.replace(",", ".") for cell in row] for row in sheet.rows])


def _read_row(line: str, separator: str, source: str, number: int) -> list[str]:
    try:
        row = next(csv.reader([line], delimiter=separator, skipinitialspace=True, strict=True))
    except csv.Error as error:
        remedy = "close its quotation marks" if '"' in line else "correct it"
        raise MeasurementError(f"{source}: row {number}: is no row of numbers ({error}); {remedy}") from None
    return [cell.strip() for cell in row]


def read_columns(
    sheet: Sheet, known: Mapping[str, str], is_optional: Callable[[str], bool], device: Device, source: str
) -> dict[str, Array]:
    """Columns (row,) in SI by name, NaN where empty; known: SI unit by the name of a column.

    Raises MeasurementError, which names the row and the column.
    """
    columns: dict[str, Array] = {}
    for index, title in enumerate(sheet.titles):
        where = f"{source}: column {index + 1}: {title!r}"
        name, scale = read_title(title, known, device, where)
        if name in columns:
            raise MeasurementError(f"{where}: is there twice")
        columns[name] = scale * read_numbers(sheet, index, source, empty_ok=is_optional(name))
    return columns


def split_title(title: str) -> tuple[str, str | None]:
    """Name and unit of a column, `position (mm)` or `position [mm]`; None without a unit."""
    match = _TITLE.fullmatch(re.sub(r"\[([^\[\]]*)\]$", r"(\1)", title.strip()))
    if match is None:
        return title.strip(), None
    return match[1].strip(), match[2].strip() if match[3] is None else f"({match[2]}){match[3]}"


def read_title(title: str, known: Mapping[str, str], device: Device, where: str) -> tuple[str, float]:
    """Name of a column and the factor that makes its values SI. Raises MeasurementError."""
    name, unit = split_title(title)
    if unit is None:
        raise MeasurementError(f"{where}: has no unit; expected a header such as position (mm)")
    if name not in known:
        near = difflib.get_close_matches(name, known, 1)
        hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(known)}"
        raise MeasurementError(f"{where}: unknown column; {hint}")
    if "position" in name and unit == "%":
        return name, side_of(device, name) / 100
    try:
        return read_column(name, unit, known[name])
    except QuantityError as error:
        raise MeasurementError(f"{where}: {error}") from None


def read_numbers(
    sheet: Sheet, index: int, source: str, *, empty_ok: bool, kind: type[float] | type[complex] = float
) -> Array:
    """A column (row,) of real numbers, or complex such as 1.2+3.4i; NaN where empty. Raises MeasurementError."""
    return np.array(
        [
            _read_cell(row[index], empty_ok, kind, f"{source}: {label}, column {sheet.titles[index]!r}")
            for row, label in zip(sheet.rows, sheet.labels, strict=True)
        ]
    )


def _read_cell(cell: str, empty_ok: bool, kind: type[float] | type[complex], where: str) -> complex:
    if not cell and empty_ok:
        return np.nan
    try:
        value = float(read_number(cell)) if kind is float else complex(cell.replace(" ", "").replace("i", "j"))
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise MeasurementError(f"{where}: {cell!r}: expected a finite number")
    return value


def example_csv(device: Device) -> str:
    """Header and a row of the right form for this device, as one line of text."""
    names = [actuator.name for actuator in device.actuators]
    place_m = split_places(device, "position", np.array([device.surface.corner_m]) / 4)
    header = [f"{name} (mm)" for name in place_m]
    header += [*(f"frequency {name} (Hz)" for name in names), "peak acceleration (m/s^2)"]
    row = [f"{1e3 * part_m[0]:.1f}" for part_m in place_m.values()]
    row += [*(f"{150 - 20 * i}" for i in range(len(names))), "0.84"]
    return f"{','.join(header)!r}, then rows such as {','.join(row)!r}"


def wrong_form(titles: Sequence[str], device: Device) -> str | None:
    """What the form of a table with these titles is, and what to do; None if it may be right."""
    first = ",".join(titles)[:_SHOWN]
    if all(map(_NUMBERS.fullmatch, titles)):
        return f"has no header: its first line is {first!r}; write one: {example_csv(device)}"
    whose = " of Klipper" if any(title.lower().startswith(("psd_", "accel_x")) for title in titles) else ""
    if any(_DENSITY.search(title) for title in titles):
        return f"holds power spectral densities{whose}, which have neither phase nor drive; {_remedy(device)}"
    if _TIME.fullmatch(titles[0]):
        unit = ", in mm/s^2" if whose else ""
        return f"is a time series{whose}{unit}: its first column is {titles[0]!r}; {_remedy(device)}"
    if any(_DAMPING.match(title) for title in titles):
        return f"has modes, as its header {first!r} says; give --modes to fit these"
    return None


def _remedy(device: Device) -> str:
    return (
        "`tactable measure` makes responses with a drive that it plays. Of a record of acceleration and drive, write "
        "their complex ratio at each frequency that was driven (scipy.signal.csd over scipy.signal.welch), the drive "
        f"in fractions of full scale; of the acceleration alone, the peak over several beats: {example_csv(device)}"
    )
