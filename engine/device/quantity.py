"""Quantities as text, such as "18.9 kN/m": read as a float in a wanted SI unit, and written back."""

from __future__ import annotations

import math
import re
import reprlib
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

from base.points import parts_of, point_text, point_words

if TYPE_CHECKING:
    import pint

# Only what describes a bar. The full default registry costs half a second and knows 'barn' and 'hogshead'.
_UNITS = (
    "giga- = 1e9 = G-",
    "mega- = 1e6 = M-",
    "kilo- = 1e3 = k-",
    "centi- = 1e-2 = c-",
    "milli- = 1e-3 = m-",
    "micro- = 1e-6 = µ- = μ- = u-",
    "nano- = 1e-9 = n-",
    "meter = [length] = m = metre",
    "second = [time] = s",
    "gram = [mass] = g",
    "percent = 0.01 = %",
    "inch = 0.0254 * meter = in",
    "hertz = 1 / second = Hz",
    "newton = 1000 * gram * meter / second ** 2 = N",
    "pascal = newton / meter ** 2 = Pa",
    "standard_gravity = 9.80665 * meter / second ** 2 = g_0",
    "pound_force = 4.4482216152605 * newton = lbf",
    "kilogram_force = 9.80665 * newton = kgf",
)
_NAMES = {
    "m": "a length",
    "kg": "a mass",
    "s": "a time",
    "Hz": "a frequency",
    "N": "a force",
    "N/m": "a stiffness",
    "N*s/m": "a damping",
    "Pa": "a pressure",
    "kg/m^3": "a density",
    "m/s^2": "an acceleration",
    "m/s": "a speed",
    "": "a plain number",
}
GRAVITY_M_PER_S2 = 9.80665  # standard gravity: exact, by definition (3rd CGPM, 1901)
_CREDIBLE = {
    "m": (1e-12, 100.0),
    "m/s^2": (1e-12, 1e6),
    "kg": (1e-9, 1e3),
    "s": (1e-9, 1e5),
    "1/s": (1e-12, 1e6),
    "Hz": (1e-3, 1e5),
    "N/m": (1e-6, 1e12),
    "N*s/m": (1e-9, 1e9),
    "Pa": (1e4, 1e13),
    "kg/m^3": (1.0, 1e5),
    "": (1e-9, 1e6),
}
"""Least and greatest value above 0 by unit, far beyond any bar or touch: what lies outside is a slip, and overflows."""
_GREATEST = 1e30  # of a plain number: its square is finite
_NUMBER = r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]{1,3})?"
# Factors joined by * · or /, one-digit exponents: pint would evaluate '5 ** 9 ** 9' for minutes.
_FACTOR = r"[A-Za-zµμ%][A-Za-zµμ%_0]*(?:\^-?\d)?"
_TEXT = re.compile(rf"({_NUMBER}) ?((?:1/)?{_FACTOR}(?:[*·/]{_FACTOR})*)?")
_ANGLE = re.compile(rf"({_NUMBER}) ?(deg|rad)")
_SIGNED, _MOST_PPM = ("drift", "gain", "offset"), 100_000
_LONGEST_TEXT = 64  # "2.5000000e-3 kg/m^3" has 19 letters; bounds the work of the patterns on hostile files
_POINTS = {1: "35mm", 2: "35x60mm"}
_SHOWN = {"N/m": (1e3, "kN/m"), "m": (1e-6, "µm"), "kg": (1e-3, "g"), "Pa": (1e9, "GPa"), "": (0.01, "%")}
_MILLIMETRE = 1e-3  # m: lengths from here on are shown in it, shorter ones, as full scales, in µm


class QuantityError(ValueError):
    """The text is not a finite number with a known unit of the wanted kind; the message is a clause."""


@cache
def _registry() -> pint.UnitRegistry[float]:
    import pint  # 0.2 s, which a command that reads no device need not wait for

    registry: pint.UnitRegistry[float] = pint.UnitRegistry(None)
    for definition in _UNITS:
        registry.define(definition)
    return registry


@cache
def _unit(text: str) -> tuple[float, pint.util.UnitsContainer]:
    """Scale to SI (grams included) and dimension of a unit such as 'kN/m'."""
    quantity = _registry().Quantity(1.0, text.replace("·", "*")).to_base_units()
    return float(quantity.magnitude), quantity.dimensionality


def _kind(dimension: pint.util.UnitsContainer) -> str:
    return next((name for unit, name in _NAMES.items() if _unit(unit)[1] == dimension), f"a quantity of {dimension}")


def read_quantity(text: object, unit: str) -> float:
    """The value of `text` ("18.9 kN/m") in `unit` ("N/m"; "" for a fraction, written "16 %").

    Raises QuantityError with a clause that says what the text is and what was expected.
    """
    expected = f"expected {_NAMES.get(unit, 'a quantity')} such as '1 {unit or '%'}'"
    shown = reprlib.repr(text)
    if not isinstance(text, str):
        raise QuantityError(f"{shown} has no unit; {expected}")
    match = _TEXT.fullmatch(text.strip()) if len(text) <= _LONGEST_TEXT else None
    if match is None:
        raise QuantityError(f"{shown} is not a number with a unit; {expected}")
    number, written = match.groups()
    if written is None:
        raise QuantityError(f"{shown} has no unit; {expected}")
    try:
        scale, dimension = _unit(written)
    except Exception as error:  # pint raises many unrelated types on malformed units
        raise QuantityError(f"{shown} has a unit that is not known ({written}); {expected}") from error
    wanted_scale, wanted_dimension = _unit(unit)
    if dimension != wanted_dimension:
        raise QuantityError(f"{shown} is {_kind(dimension)}; {expected}")
    value = float(number) * (scale / wanted_scale)
    smallest, greatest = _CREDIBLE.get(unit, (0.0, _GREATEST))
    if value and not smallest <= abs(value) <= greatest:
        raise QuantityError(f"{shown} is beyond belief: {expected}, of {smallest:g} to {greatest:g} {unit}".rstrip())
    return value


def read_point(text: str) -> complex:
    """The point of the surface of `text` in metres: "35 mm", or on a plate "35 x 60 mm". Raises QuantityError."""
    parts = [read_quantity(word, "m") for word in point_words(text)]
    return complex(*parts) if len(parts) == 2 else parts[0]


def read_point_on(text: str, corner_m: complex, *, beside_too: bool = False) -> complex:
    """The point of the surface from 0 to `corner_m`: "35 mm" or "12.5 %" on a bar, "35 x 60 mm" on a plate.

    Raises QuantityError where the text is no point and, unless `beside_too`, where that is beside the surface.
    """
    words, sides_m = point_words(text), parts_of(corner_m)
    if len(words) != len(sides_m):
        expected = f"expected one such as {_POINTS[len(sides_m)]}"
        raise QuantityError(f"{reprlib.repr(text)} is no point of the surface; {expected}")
    shares = [word.rstrip().endswith("%") for word in words]
    found = [
        read_quantity(word, "") * side_m if is_share else read_quantity(word, "m")
        for word, side_m, is_share in zip(words, sides_m, shares, strict=True)
    ]
    if not beside_too and not all(0 <= part_m <= side_m for part_m, side_m in zip(found, sides_m, strict=True)):
        raise QuantityError(f"{reprlib.repr(text)} is off the surface, which reaches from 0 to {point_text(corner_m)}")
    return complex(*found) if isinstance(corner_m, complex) else found[0]


def read_number(text: str) -> float:
    """The value of plain text such as "40" or "-1.5e3", but not "nan", "inf" or "1_000". Raises QuantityError."""
    match = re.fullmatch(_NUMBER, text.strip()) if len(text) <= _LONGEST_TEXT else None
    if match is None or not abs(value := float(match[0])) <= _GREATEST:
        raise QuantityError(f"{reprlib.repr(text)} is no number; expected one such as 40 or -1.5e3")
    return value


def read_words(text: str, words: Mapping[str, tuple[str, str]]) -> dict[str, Any]:
    """Values by field of a text such as "gain=3 %, drift=40"; `words` have the field and the unit of each.

    The unit "ppm" stands for millionths, "number" for plain numbers and "point" for a point of the surface. Raises
    QuantityError, which names the word.
    """
    found = dict[str, Any]()
    for part in filter(None, (part.strip() for part in text.split(","))):
        key, _, value = (piece.strip() for piece in part.partition("="))
        if key not in words:
            raise QuantityError(f"{reprlib.repr(key)} is not known; known are {', '.join(words)}")
        field, unit = words[key]
        try:
            number = _READERS[unit](value) if unit in _READERS else read_quantity(value, unit)
        except QuantityError as error:
            raise QuantityError(f"{key}: {error}") from None
        if field in found or (number.real < 0 and key not in _SIGNED) or (unit == "ppm" and abs(number) > _MOST_PPM):
            bounds = f"at most {_MOST_PPM} either way" if unit == "ppm" else "at least 0"
            raise QuantityError(f"{key}={value}: expected once, and {bounds}")
        found[field] = number * 1e-6 if unit == "ppm" else number
    return found


_READERS: Mapping[str, Callable[[str], Any]] = {"ppm": read_number, "number": read_number, "point": read_point}


def read_angle_rad(text: object) -> float:
    """The value of `text` in radians: "90 deg" or "1.57 rad". Raises QuantityError."""
    match = _ANGLE.fullmatch(text.strip()) if isinstance(text, str) and len(text) <= _LONGEST_TEXT else None
    if match is None:
        raise QuantityError(f"{reprlib.repr(text)} is no angle; expected one such as 90deg or 1.57rad")
    number, unit = match.groups()
    return math.radians(float(number)) if unit == "deg" else float(number)


def quantity_text(value: float, unit: str, digits: int = 4) -> str:
    """The SI value as people write it and `read_quantity` reads it: "18.9 kN/m" for 18900.0 and "N/m"."""
    scale, shown = _shown(unit, value)
    return f"{value / scale:.{digits}g} {shown}"


def interval_text(ends: Sequence[float], unit: str, digits: int = 4) -> str:
    """The interval between two SI values, such as "18.9 to 19.1 kN/m"."""
    low, high = ends
    scale, shown = _shown(unit, high)
    return f"{low / scale:.{digits}g} to {high / scale:.{digits}g} {shown}"


def _shown(unit: str, greatest: float) -> tuple[float, str]:
    """Scale and unit that values of up to `greatest` are shown in."""
    if unit == "m" and abs(greatest) >= _MILLIMETRE:
        return _MILLIMETRE, "mm"
    return _SHOWN.get(unit, (1.0, unit))
