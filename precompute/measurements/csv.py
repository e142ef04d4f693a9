"""Tables of measurements with units in the header (tables/MEASUREMENTS.md), plain or wide: read, and written as CSV.

A wide table has one column of frequencies and columns of readings for each place. A heading says the actuator, the
place and the part of the reading in any order, then the unit: `left 35 mm real (m/s^2)`. Without a part the cells are
complex, such as 1.2+3.4i. A word that is not known is refused.
"""

import csv
import io
import re
from typing import NamedTuple

import numpy as np

from base.arrays import Array, Points
from base.points import point_text
from engine.device import Device
from engine.device.quantity import QuantityError, read_point_on
from precompute.measurements.columns import (
    OPTIONAL,
    QUANTITIES,
    SIMULATED,
    assemble_measurements,
    column_names,
    split_places,
)
from precompute.measurements.sheet import (
    Sheet,
    read_columns,
    read_numbers,
    read_sheet,
    read_title,
    split_title,
    wrong_form,
)
from precompute.measurements.types import Kind, MeasurementError, Measurements


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


FREQUENCY = re.compile(r"f|freq\.?|frequency|frequenz|fréquence|frequence", re.IGNORECASE)
_NUMBER = r"\d+(?:[.,]\d+)?"
PLACE = re.compile(
    rf"((?:(?<![^\s_])[-+]|(?<![^\W_])(?<![.,])){_NUMBER}(?: ?[x×] ?{_NUMBER})? ?(?:mm|cm|m|%))(?![^\W_])(?![/^])"  # noqa: RUF001
)
_OF_A_FREQUENCY = re.compile(r"(?<![\w.,])\d+(?:[.,]\d+)? ?k?Hz(?!\w)")
_PARTS = {
    **dict.fromkeys(("real", "re"), "real"),
    **dict.fromkeys(("imaginary", "imag", "im"), "imaginary"),
    **dict.fromkeys(("magnitude", "mag", "amplitude", "abs"), "magnitude"),
    **dict.fromkeys(("phase", "arg", "angle"), "phase"),
    "peak": "peak",
}
_FILLERS = frozenset(("", "response", "frf", "h", "at", "x"))


class _Heading(NamedTuple):
    """What a column holds: `name` as in a plain table, None for complex cells of `quantity`."""

    actuator: int
    place_m: complex
    quantity: str
    name: str | None


def read_wide(sheet: Sheet, device: Device, source: str) -> tuple[dict[str, Array], list[str]] | None:
    """Columns (row,) in SI with a row for each reading, and the label of each row; None for a table that is not wide.

    Lines at 0 Hz, and places without a reading in a line, are passed over. Raises MeasurementError.
    """
    names, known = [split_title(title)[0] for title in sheet.titles], column_names(device)
    axes = [i for i, name in enumerate(names) if FREQUENCY.fullmatch(name) or name.startswith("frequency ")]
    wide = [i for i, name in enumerate(names) if name not in known and i not in axes]
    by_frequency = [names[i] for i in wide if _OF_A_FREQUENCY.search(names[i])]
    is_wide = "position" not in names and any(PLACE.search(names[i]) for i in wide)
    if not is_wide and not by_frequency:
        return None
    if len(axes) != 1 or by_frequency:
        what = f"{by_frequency[0]!r} is a column of one frequency" if by_frequency else f"it has {len(axes)} of them"
        raise MeasurementError(
            f"{source}: is a wide table: expected one column of the frequencies, but {what}; {_example(device)}"
        )
    hz, own = _frequencies(sheet, axes[0], device, source)
    groups: dict[tuple[int, complex], dict[str, Array]] = {}
    for i in wide:
        where = f"{source}: column {i + 1}: {sheet.titles[i]!r}"
        heading = _read_heading(names[i], device, own, where)
        found = groups.setdefault(heading[:2], {})
        for name, value in _read_parts(sheet, i, heading, device, source, where).items():
            if name in found:
                raise MeasurementError(f"{where}: is there twice")
            found[name] = value
    others = {}
    for i in range(len(names)):
        if i not in wide and i not in axes:
            name, scale = read_title(sheet.titles[i], known, device, f"{source}: column {i + 1}: {sheet.titles[i]!r}")
            others[name] = scale * read_numbers(sheet, i, source, empty_ok=True)
    return _stacked(groups, hz, others, sheet, device, source)


def _stacked(
    groups: dict[tuple[int, complex], dict[str, Array]],
    hz: Array,
    others: dict[str, Array],
    sheet: Sheet,
    device: Device,
    source: str,
) -> tuple[dict[str, Array], list[str]]:
    """The readings of all places below one another."""
    parts, first = next(iter(groups.values())).keys(), next(iter(groups))
    rows: dict[str, list[Array]] = {}
    labels = list[str]()
    for (which, place_m), values in groups.items():
        what = f"{device.actuators[which].name} at {point_text(place_m, 4)}"
        if values.keys() != parts:
            mine, theirs = (" and ".join(sorted(each)) for each in (values, parts))
            other = f"{device.actuators[first[0]].name} at {point_text(first[1], 4)}"
            raise MeasurementError(f"{source}: {what}: has {mine}, but {other} has {theirs}; give all the same")
        empty = [np.isnan(value) for value in values.values()]
        if any((each != empty[0]).any() for each in empty):
            row = int(np.argmax(np.any([each != empty[0] for each in empty], axis=0)))
            raise MeasurementError(f"{source}: {sheet.labels[row]}: {what}: has a part of a reading; give both or none")
        kept = (hz > 0) & ~empty[0]
        labels += [f"{label}: {what}" for label, is_kept in zip(sheet.labels, kept, strict=True) if is_kept]
        own = others | {f"frequency {a.name}": np.full(len(hz), np.nan) for a in device.actuators}
        for i, actuator in enumerate(device.actuators):  # the others are still
            for name in (f"amplitude {actuator.name}", f"phase {actuator.name}"):
                if name in own and i != which:
                    own[name] = np.full(len(hz), np.nan)
        own |= {f"frequency {device.actuators[which].name}": hz}
        own |= split_places(device, "position", np.full(len(hz), place_m))
        for name, value in (values | own).items():
            rows.setdefault(name, []).append(value[kept])
    return {name: np.concatenate(value) for name, value in rows.items()}, labels


def _frequencies(sheet: Sheet, axis: int, device: Device, source: str) -> tuple[Array, int | None]:
    """The frequencies (row,), and the index of the actuator that their heading names, or of the only one."""
    name, unit = split_title(sheet.titles[axis])
    where = f"{source}: column {axis + 1}: {sheet.titles[axis]!r}"
    named = [i for i, actuator in enumerate(device.actuators) if name == f"frequency {actuator.name}"]
    if not named and not FREQUENCY.fullmatch(name):
        raise MeasurementError(f"{where}: names no actuator; they are {_actuators(device)}")
    scale = read_title(f"frequency ({unit})" if unit else "frequency", {"frequency": "Hz"}, device, where)[1]
    hz = scale * read_numbers(sheet, axis, source, empty_ok=False)
    return hz, named[0] if named else 0 if len(device.actuators) == 1 else None


def _read_heading(name: str, device: Device, own: int | None, where: str) -> _Heading:
    place = PLACE.search(name)
    if place is None:
        raise MeasurementError(f"{where}: names no place; {_example(device)}")
    try:
        # What is off the surface is refused with its row.
        place_m = read_point_on(place[1].replace(",", "."), device.surface.corner_m, beside_too=True)
    except QuantityError as error:
        raise MeasurementError(f"{where}: {error}") from None
    rest = f"{name[: place.start()]} {name[place.end() :]}"
    for i in sorted(range(len(device.actuators)), key=lambda i: -len(device.actuators[i].name)):
        found = re.search(rf"(?<![^\W_]){re.escape(device.actuators[i].name)}(?![^\W_])", rest, re.IGNORECASE)
        if found:
            own, rest = i, f"{rest[: found.start()]} {rest[found.end() :]}"
            break
    if own is None:
        raise MeasurementError(f"{where}: names no actuator; they are {_actuators(device)}: {_example(device)}")
    quantity, part = "acceleration", ""
    for word in re.split(r"[\s,_:|-]+", rest.lower()):
        if word in _PARTS and not part:
            part = _PARTS[word]
        elif word in QUANTITIES:
            quantity = word
        elif word not in _FILLERS:
            raise MeasurementError(f"{where}: {word!r} is no part of a reading; {_example(device)}")
    name = "peak acceleration" if part == "peak" else f"{quantity} {part}"
    return _Heading(own, place_m, quantity, name if part else None)


def _read_parts(
    sheet: Sheet, index: int, heading: _Heading, device: Device, source: str, where: str
) -> dict[str, Array]:
    """The columns (row,) in SI of a heading: one, or the real and the imaginary part of complex cells."""
    unit, known = split_title(sheet.titles[index])[1], column_names(device)
    names = [f"{heading.quantity} real", f"{heading.quantity} imaginary"] if heading.name is None else [heading.name]
    read = [read_title(name if unit is None else f"{name} ({unit})", known, device, where) for name in names]
    kind = complex if heading.name is None else float
    value = read[0][1] * read_numbers(sheet, index, source, empty_ok=True, kind=kind)
    if heading.name is not None:
        return {read[0][0]: value}
    if not np.iscomplexobj(value) or not value.imag[~np.isnan(value)].any():
        raise MeasurementError(
            f"{where}: its cells are real and its heading says no part; write real and imaginary, magnitude and phase, "
            f"or peak: {_example(device)}"
        )
    return {read[0][0]: value.real, read[1][0]: np.where(np.isnan(value), np.nan, value.imag)}


def _actuators(device: Device) -> str:
    return ", ".join(actuator.name for actuator in device.actuators)


def _example(device: Device) -> str:
    name = device.actuators[0].name
    return f"write headings such as frequency (Hz),{name} 35 mm real (m/s^2),{name} 35 mm imaginary (m/s^2)"
