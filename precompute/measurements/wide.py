"""Wide tables, which have one column of frequencies and columns of readings for each place, to columns of measurements.

A heading says the actuator, the place and the part of the reading in any order, then the unit: `left 35 mm real
(m/s^2)`. Without a part the cells are complex, such as 1.2+3.4i. A word that is not known is refused.
"""

import re
from typing import NamedTuple

import numpy as np

from base.arrays import Array
from base.points import point_text
from engine.device import Device
from engine.device.quantity import QuantityError, read_point_on
from precompute.measurements.columns import column_names, split_places
from precompute.measurements.response_unit import QUANTITIES
from precompute.measurements.sheet import Sheet, read_numbers, read_title, split_title
from precompute.measurements.types import MeasurementError

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
