"""Unit of a response as others write it, such as (m/s²)/N or g/lbf: to its quantity and the factor that makes it SI."""

import re
import reprlib
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from base.arrays import Array, Complex
from engine.device.quantity import QuantityError, read_quantity

_PER_NEWTON, _LONGEST = 3, 65
QUANTITIES = {
    "acceleration": "m/s^2",
    "velocity": "m/s",
    "displacement": "m",
    "accelerance": "m/s^2/N",
    "mobility": "m/s/N",
    "receptance": "m/N",
}
"""SI units of responses: at full scale, then in the same order per newton (ISO 7626-1)."""
_NAMES = list(QUANTITIES)
_SUPERSCRIPTS = str.maketrans("⁻¹²³⁴", "-1234")
_INVERSE = str.maketrans("*/", "/*")


class ResponseUnit(NamedTuple):
    """What the values of a response are: `scale` makes them SI, and multiplied by (j omega)^order an acceleration."""

    scale: float
    order: int
    is_per_newton: bool

    @property
    def quantity(self) -> str:
        """The name of the quantity, as in QUANTITIES."""
        return _NAMES[self.order + _PER_NEWTON * self.is_per_newton]


def read_response_unit(text: str) -> ResponseUnit:
    """The quantity whose unit `text` is; g is gravity, Ns newton seconds, M/S^2 is m/s^2. Raises QuantityError."""
    plain = _without_brackets(text[:_LONGEST])  # no unit is longer
    of_gravity = re.sub(r"(?<![A-Za-z_])([mµμ]?)g(?![A-Za-z_])", r"\1g_0", plain, flags=re.IGNORECASE)
    capitals = re.sub(r"\bn\b", "N", of_gravity.lower()) if text == text.upper() else plain
    for candidate in (plain, of_gravity, capitals):
        for number, unit in enumerate(QUANTITIES.values()):
            with suppress(QuantityError):
                scale = read_quantity(f"1 {candidate}", unit)
                return ResponseUnit(scale, number % _PER_NEWTON, number >= _PER_NEWTON)
    raise QuantityError(f"{reprlib.repr(text)} is no unit of a response; expected {', '.join(QUANTITIES.values())}")


def to_acceleration(value: Complex, order: int, frequency_hz: Array) -> Complex:
    """Accelerations of a response (row,) that is a velocity (order 1) or a displacement (2), at frequency_hz (row,)."""
    return value * (2j * np.pi * frequency_hz) ** order


def _without_brackets(text: str) -> str:
    """The unit as factors in one row, such as m/s^2/N, from m/(N·s²), (m/s**2)/N or m s-2 N-1."""
    out = text.strip().replace("**", "^").replace("·", "*").replace("sec", "s")
    out = re.sub(r"\bns(\^?\d)?", r"(N*s\1)", out, flags=re.IGNORECASE)
    out = re.sub(r"\^?([⁻¹²³⁴]+)", lambda found: "^" + found[1].translate(_SUPERSCRIPTS), out)
    out = re.sub(r"(?<=[A-Za-zµμ])(-?\d)", r"^\1", re.sub(r" *([*/()]) *", r"\1", out))
    out = re.sub(r" +", "*", out)
    while (plain := re.sub(r"(/?)\(([^()]*)\)", _opened, out)) != out:
        out = plain
    return out


def _opened(found: re.Match[str]) -> str:
    """Content of a pair of brackets; after a slash every factor is inverted."""
    return f"/{found[2].translate(_INVERSE)}" if found[1] else found[2]
