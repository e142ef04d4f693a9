"""Reads the table [calibration] of a device file (tables/MEASUREMENTS.md): the fitted values and their covariance."""

import math
import re
from typing import Any

from engine.device.parts import FittedValue, Uncertainty
from engine.device.toml_table import TomlTable

FITTED_UNITS = {
    "actuator.stiffness": "N/m",
    "actuator.damping": "N*s/m",
    "actuator.full_scale": "m",
    "actuator.mass": "kg",
    "actuator.clamp": "m",
    "actuator.delay": "s",
    **{f"{kind}.mass_damping": "1/s" for kind in ("bar", "plate")},
    **{f"{kind}.stiffness_damping": "s" for kind in ("bar", "plate")},
    **{f"{kind}.youngs_modulus": "Pa" for kind in ("bar", "plate")},
    **{f"{kind}.density": "kg/m^3" for kind in ("bar", "plate")},
    "plate.poissons_ratio": "",
    "finger.mass": "kg",
    "finger.damping": "N*s/m",
    "finger.stiffness": "N/m",
}
"""Units of the values that a calibration can fit; actuator[2].mass is of one actuator, actuator.mass of all."""
_PROVENANCE = ("created", "measurements", "sha256", "report", "loss")  # "loss": of files of earlier versions
_ROUNDING = 1e-9


def read_uncertainty(part: TomlTable, actuators: int) -> Uncertainty:
    """The uncertainty that the table states. Raises the error class of the file."""
    for key in _PROVENANCE:
        part.sentence(key)
    fitted = tuple(_read_fitted(value, actuators) for value in part.tables("fitted"))
    names = [value.name for value in fitted]
    if len(set(names)) < len(names):
        raise part.error("fitted", names, "names a value twice")
    return Uncertainty(fitted, _read_covariance(part, len(fitted)))


def _read_fitted(part: TomlTable, actuators: int) -> FittedValue:
    name = part.take_value("name")
    match = re.fullmatch(r"(\w+)(?:\[([1-9]\d{0,2})\])?\.(\w+)", name) if isinstance(name, str) else None
    key = f"{match[1]}.{match[3]}" if match else ""
    if match is None or key not in FITTED_UNITS or (match[2] and match[1] != "actuator"):
        raise part.error("name", name, f"expected such as actuator[1].stiffness; known are {', '.join(FITTED_UNITS)}")
    if match[2] and int(match[2]) > actuators:
        raise part.error("name", name, f"there are {actuators} actuators")
    unit = FITTED_UNITS[key]
    low = part.quantity("low", unit)
    value = FittedValue(
        name=name,
        low=low,
        high=part.quantity("high", unit, least=low, exclusive=True),
        knee=part.quantity("knee", unit, default=f"0 {unit or '%'}"),
    )
    if value.knee == 0 and low == 0:
        raise part.error("low", f"0 {unit or '%'}", "expected more than 0 for a value without a knee")
    part.refuse_rest()
    return value


def _read_covariance(part: TomlTable, count: int) -> tuple[tuple[float, ...], ...]:
    rows: Any = part.take_value("covariance")
    expected = f"expected {count} rows of {count} numbers, symmetric, none above what its diagonal allows"
    is_square = isinstance(rows, list) and len(rows) == count
    if not is_square or not all(isinstance(row, list) and len(row) == count for row in rows):
        raise part.error("covariance", rows, expected)
    if not all(type(value) in (float, int) and math.isfinite(value) for row in rows for value in row):
        raise part.error("covariance", rows, expected)
    for i in range(count):
        for j in range(i + 1):
            limit = math.sqrt(max(rows[i][i], 0.0) * max(rows[j][j], 0.0)) * (1 + _ROUNDING)
            if abs(rows[i][j] - rows[j][i]) > _ROUNDING * limit or abs(rows[i][j]) > limit or rows[i][i] < 0:
                raise part.error("covariance", rows, expected)
    return tuple(tuple(float(value) for value in row) for row in rows)
