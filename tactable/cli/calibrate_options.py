"""What the commands around calibration are given as text, to values: parameters with bounds, drives, quantities."""

import math
from collections.abc import Sequence
from enum import Enum
from typing import TypeVar

from engine.device import Device
from engine.device.quantity import QuantityError, read_quantity
from precompute.measurements import CalibrationError
from precompute.measurements.parameters import Bounds, default_names, parameter_unit

_Choice = TypeVar("_Choice", bound=Enum)


def read_option(option: str, text: str, unit: str) -> float:
    """A quantity of at least 0. Raises CalibrationError."""
    try:
        value = read_quantity(text, unit)
    except QuantityError as error:
        raise CalibrationError(f"{option}: {error}") from None
    if value < 0:
        raise CalibrationError(f"{option} {text!r}: expected at least 0")
    return value


def read_choice(option: str, text: str, choices: type[_Choice]) -> _Choice:
    """One of the values of an enumeration. Raises CalibrationError."""
    for choice in choices:
        if choice.value == text:
            return choice
    raise CalibrationError(f"{option} {text!r}: expected one of {', '.join(choice.value for choice in choices)}")


def read_parameters(
    device: Device, fit: Sequence[str] | None, also: Sequence[str] | None
) -> tuple[tuple[str, ...], dict[str, Bounds]]:
    """Names to fit and the bounds that were given, SI, of texts such as "bar.density=2.6e3 kg/m^3..2.8e3 kg/m^3".

    Raises CalibrationError.
    """
    bounds: dict[str, Bounds] = {}
    names = [] if fit else list(default_names(device))
    for option, texts in (("--fit", fit or []), ("--also", also or [])):
        for text in texts:
            name, _, limits = text.partition("=")
            if name not in names:
                names.append(name)
            if limits:
                bounds[name] = _read_bounds(f"{option} {name}", limits, parameter_unit(device, name))
    return tuple(names), bounds


def _read_bounds(option: str, text: str, unit: str) -> Bounds:
    low, separator, high = text.partition("..")
    if not separator:
        raise CalibrationError(f"{option}={text}: expected bounds such as 1 {unit}..2 {unit}")
    return read_option(option, low, unit), read_option(option, high, unit)


def read_drives(text: str, device: Device) -> list[list[float]]:
    """Frequencies (drive, actuator) of a text such as "150,130;140,-"; NaN for a still actuator.

    Raises CalibrationError.
    """
    drives = [[_read_frequency(part) for part in drive.split(",")] for drive in text.split(";") if drive.strip()]
    for drive in drives:
        if len(drive) != len(device.actuators) or all(math.isnan(hz) for hz in drive):
            names = ",".join(actuator.name for actuator in device.actuators)
            raise CalibrationError(
                f"--drives {text!r}: expected frequencies in Hz of {names}, - for still; such as 150,130"
            )
    if not drives:
        raise CalibrationError("--drives names no drive; give at least one, such as 150,130")
    return drives


def _read_frequency(text: str) -> float:
    if text.strip() == "-":
        return math.nan
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise CalibrationError(f"--drives: {text!r}: expected a frequency in Hz, or - for still")
    return value


def read_changes(texts: Sequence[str], device: Device) -> dict[str, float]:
    """Values (SI) by name of texts such as "actuator[1].stiffness=20 kN/m". Raises CalibrationError."""
    changes = {}
    for text in texts:
        name, _, value = text.partition("=")
        changes[name] = read_option(f"--change {name}", value, parameter_unit(device, name))
    return changes
