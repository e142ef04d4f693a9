"""Flattens a device into values by name, such as actuator[1].stiffness_n_per_m, and compares two sets of values."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from itertools import chain
from typing import Any

from engine.device.device import Device
from engine.device.parts import Uncertainty

Value = int | float | str | None

_WORDING = ("description", "inferred", "text", "uncertainty")
_PARTS = {"actuators": "actuator", "zones": "zone"}
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
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value
