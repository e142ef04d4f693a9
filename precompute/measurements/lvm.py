"""LabVIEW measurement files (.lvm) of one segment over frequency, read as wide tables (tables/MEASUREMENTS.md).

The form is that of National Instruments' "Specification for the LabVIEW Measurement File".
"""

from collections.abc import Mapping, Sequence

from engine.device import Device
from precompute.measurements.columns import SIMULATED
from precompute.measurements.csv import measurements_of
from precompute.measurements.sheet import Sheet, check_sheet, split_title, wrong_form
from precompute.measurements.types import MeasurementError, Measurements

_END = "***End_of_Header***"


def parse_lvm(text: str, device: Device, sensor_mass_kg: float, source: str) -> Measurements:
    """Read responses from channels that are named as the columns of a wide table; raises MeasurementError.

    The unit of a channel is its Y_Unit_Label, or in its name. A time series is refused with what to do.
    """
    lines = text.splitlines()
    ends = [number for number, line in enumerate(lines) if line.startswith(_END)]
    if not text.startswith("LabVIEW Measurement") or len(ends) != 2 or len(lines) < ends[1] + 3:
        expected = "expected the first line 'LabVIEW Measurement', its header, and one segment with its header and data"
        raise MeasurementError(f"{source}: has {max(len(ends) - 1, 0)} segments; {expected}")
    told = [line.removeprefix("Separator") for line in lines[: ends[0]] if line.startswith("Separator")]
    separator = "," if told and told[0].strip() in (",", "Comma", ",Comma") else "\t"
    cells = [[cell.strip() for cell in line.split(separator)] for line in lines]
    tags = {row[0]: row[1:] for row in cells[: ends[1]]}
    x_units = {cell for cell in tags.get("X_Unit_Label", []) if cell.endswith("Hz")}
    if "Frequency" not in tags.get("X_Dimension", []) and not x_units:
        remedy = "if it is a spectrum, which LabVIEW may mark as Time, write Frequency as its X_Dimension"
        raise MeasurementError(f"{source}: {wrong_form(['time'], device)}; {remedy}")
    titles = cells[ends[1] + 1]
    titles = titles[: titles.index("Comment")] if "Comment" in titles else titles
    point = _tag(tags, "Decimal_Separator", ",") if separator != "," else "."
    numbered = [(n, row) for n, row in enumerate(cells[ends[1] + 2 :], ends[1] + 3) if any(row)]
    rows = [[cell.replace(point, ".") for cell in (row + [""] * len(titles))[: len(titles)]] for _, row in numbered]
    labels = [f"row {n}" for n, _ in numbered]
    if _tag(tags, "X_Columns", "One") == "No":
        start, step = (_number(tags, key, point, source) for key in ("X0", "Delta_X"))
        rows = [[repr(start + step * i), *row[1:]] for i, row in enumerate(rows)]
    axes = [i for i, title in enumerate(titles) if title == "X_Value"]
    for label, row in zip(labels, rows, strict=True):
        if axes[:1] != [0] or len({row[i] for i in axes}) != 1:
            expected = "expected X_Value as the first column, and the same in all others of this name"
            raise MeasurementError(f"{source}: {label}: X_Value: {[row[i] for i in axes]}: {expected}")
    kept = [i for i in range(len(titles)) if i not in axes]
    units = {i: unit for i, unit in enumerate(tags.get("Y_Unit_Label", []), 1) if unit}  # above their columns
    named = [titles[i] if split_title(titles[i])[1] or i not in units else f"{titles[i]} ({units[i]})" for i in kept]
    sheet = Sheet(
        titles=[f"frequency ({min(x_units, default='Hz')})", *named],
        rows=[[row[0], *(row[i] for i in kept)] for row in rows],
        labels=labels,
        is_simulated=any(SIMULATED in line for line in lines[: ends[1]]),
    )
    return measurements_of(check_sheet(sheet, source, has_commas=True), device, sensor_mass_kg, source)


def _tag(tags: Mapping[str, Sequence[str]], key: str, default: str) -> str:
    return next((cell for cell in tags.get(key, []) if cell), default)


def _number(tags: Mapping[str, Sequence[str]], key: str, point: str, source: str) -> float:
    text = _tag(tags, key, "")
    try:
        return float(text.replace(point, "."))
    except ValueError:
        raise MeasurementError(f"{source}: {key}: {text!r}: expected a number, since X_Columns is No") from None
