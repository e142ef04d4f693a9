"""Lists the values of a device by name, such as actuator[1].stiffness_n_per_m, compares and replaces them."""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from itertools import chain
from typing import Any

from base.points import point_text
from engine.device.device import Device
from engine.device.parts import DeviceError, Uncertainty
from engine.device.quantity import quantity_text

Value = int | float | complex | str | None

_WORDING = ("description", "inferred", "text", "uncertainty", "finger_origin")
_PARTS = {"actuators": "actuator", "zones": "zone"}
_UNITS = {
    "_kg_per_m3": "kg/m^3",
    "_n_s_per_m": "N*s/m",
    "_n_per_m": "N/m",
    "_m_per_s": "m/s",
    "_per_s": "1/s",
    "_pa": "Pa",
    "_kg": "kg",
    "_hz": "Hz",
    "_m": "m",
    "_s": "s",
}
"""Unit by the ending of a value's name; without the ending it is the key in the file."""
_FRACTIONS = re.compile(r"spread\..*|limits\.amplitude")
_WRITTEN_DIGITS = 15  # DBL_DIG: every decimal of this many digits passes through a float unchanged
_DIGITS = 12  # as Device.fingerprint: "27.94 cm" and "279.4 mm" are the same


@dataclass(frozen=True)
class Change:
    """A value that changed; None stands for an absent one."""

    key: str
    before: Value
    after: Value

    @property
    def percent(self) -> float | None:
        """Relative change in per cent; None where a value is no number, or the one before is 0."""
        before, after = number_of(self.before), number_of(self.after)
        return None if before is None or after is None or before == 0 else 100 * (after / before - 1)


def number_of(value: Value) -> float | None:
    """The value as a number; None where it is not one."""
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def device_values(device: Device) -> dict[str, Value]:
    """Every value that the model or the engine uses, in SI units, in the order of the description."""
    values = {key: value for key, value in asdict(device).items() if key not in _WORDING}
    values = {device.surface.kind if key == "surface" else key: value for key, value in values.items()}
    values["threshold"] = device.threshold.name
    uncertainty = device.uncertainty
    return dict(_flat("", values)) | ({} if uncertainty is None else _uncertainty_values(uncertainty))


def _uncertainty_values(uncertainty: Uncertainty) -> dict[str, Value]:
    """Standard deviation of every fitted coordinate, and the correlations between them."""
    names, covariance = [value.name for value in uncertainty.fitted], uncertainty.covariance
    deviation = [math.sqrt(row[i]) for i, row in enumerate(covariance)]
    correlation = (
        f"{covariance[i][j] / (deviation[i] * deviation[j] or 1.0):.3f}" for i in range(len(names)) for j in range(i)
    )
    deviations = {f"uncertainty.{name}": value for name, value in zip(names, deviation, strict=True)}
    return {**deviations, "uncertainty.correlation": " ".join(correlation)}


def _flat(path: str, value: Any) -> Iterator[tuple[str, Value]]:
    if isinstance(value, dict):
        for key, part in value.items():
            name = _PARTS.get(str(key), str(key))
            yield from _flat(f"{path}.{name}" if path else name, part)
    elif isinstance(value, tuple):
        for i, part in enumerate(value, 1):
            yield from _flat(f"{path}[{i}]", part)
    else:
        yield path, value


def compare_values(before: Mapping[str, Value], after: Mapping[str, Value]) -> tuple[Change, ...]:
    """The values that differ: in the order of `before`, then those that are new."""
    keys = dict.fromkeys(chain(before, after))
    changes = (Change(key, before.get(key), after.get(key)) for key in keys)
    return tuple(change for change in changes if _rounded(change.before) != _rounded(change.after))


def _rounded(value: Value) -> Value:
    if isinstance(value, complex):
        return complex(float(f"{value.real:.{_DIGITS}g}"), float(f"{value.imag:.{_DIGITS}g}"))
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value


def restated(device: Device) -> Device:
    """A device that was made by dataclasses.replace, with a text that states its values.

    Raises DeviceError where the text cannot state them: zones, bands and levels, which are more than one value.
    """
    found, values = Device.parse(device.text, device.name), device_values(device)
    for _ in range(2):  # values that follow from others, such as the mesh's, show once these are stated
        changes = compare_values(device_values(found), values)
        try:
            found = found.with_values(dict(_statement(change) for change in changes))
        except DeviceError:
            break
    if found.fingerprint != device.fingerprint:
        keys = ", ".join(change.key for change in changes)
        raise DeviceError(f"{device.name}: {keys} changed after it was read; write new values to a file and read it")
    return found if changes else device


def _statement(change: Change) -> tuple[str, str | float]:
    """A value as the file states it."""
    value = change.after
    if value is None:
        raise DeviceError(f"{change.key}: is gone")
    ending = next((each for each in _UNITS if change.key.endswith(each)), None)
    key = change.key.removesuffix(ending or "")
    if isinstance(value, complex):
        return key, point_text(value, _WRITTEN_DIGITS)
    if isinstance(value, float) and ending is not None:
        return key, quantity_text(value, _UNITS[ending], _WRITTEN_DIGITS)
    if isinstance(value, float) and _FRACTIONS.fullmatch(key):
        return key, f"{100 * value:.{_WRITTEN_DIGITS}g} %"
    return key, value
