"""Parameters of a device that can be fitted, named as in its file, such as actuator[1].stiffness."""

import difflib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from base.arrays import Array
from engine.device import Device
from engine.device.uncertainty import FITTED_UNITS
from precompute.measurements.types import CalibrationError

Bounds = tuple[float, float]

_SENSOR_UNIT = "kg"


class ParameterError(CalibrationError):
    """A parameter cannot be fitted as asked; the message names it, the value and the remedy."""


@dataclass(frozen=True)
class Quantity:
    """One number of a part of the device: its field, the paper's letter and the usual bounds of a fit.

    The bounds are the device's value divided and multiplied by `factor`, and at most `greatest` where that is given.
    A damping, which no data sheet states, lies between 0 and `greatest`; from `knee` on it affects a bar of some grams
    at some 100 Hz.
    """

    field: str
    letter: str
    factor: float = 1.0
    greatest: float = 0.0
    knee: float = 0.0


_MEASURED = "measure it; a fit says where another {} would explain the readings"
_RULED = {
    "bar.length": _MEASURED.format("length"),
    "plate.length": _MEASURED.format("length"),
    "plate.width": _MEASURED.format("width"),
    ".thickness": "{0}.youngs_modulus and {0}.density stand for it, since the motion depends on E h^3 and rho h",
    ".position": _MEASURED.format("place"),
}
"""What to do about lengths, by what their names end in."""
_SURFACE = {
    "mass_damping": Quantity("mass_damping_per_s", "sigma", greatest=100.0, knee=0.3),
    "stiffness_damping": Quantity("stiffness_damping_s", "eta", greatest=1e-2, knee=1e-6),
    "youngs_modulus": Quantity("youngs_modulus_pa", "E", factor=1.5),
    "density": Quantity("density_kg_per_m3", "rho", factor=1.5),
}
QUANTITIES: Mapping[str, Mapping[str, Quantity]] = {
    "actuator": {
        "stiffness": Quantity("stiffness_n_per_m", "k", factor=3.0),
        "damping": Quantity("damping_n_s_per_m", "c", greatest=10.0, knee=3e-3),
        "full_scale": Quantity("full_scale_m", "alpha", factor=10.0),
        "mass": Quantity("mass_kg", "m", factor=5.0),
        "clamp": Quantity("clamp_m", "w", factor=3.0),
        "delay": Quantity("delay_s", "tau", greatest=1e-3, knee=1e-6),
    },
    "bar": _SURFACE,
    "plate": {**_SURFACE, "poissons_ratio": Quantity("poissons_ratio", "nu", factor=2.0, greatest=0.5)},
    "finger": {
        "mass": Quantity("mass_kg", "m_finger", factor=30.0),
        "damping": Quantity("damping_n_s_per_m", "c_finger", factor=30.0),
        "stiffness": Quantity("stiffness_n_per_m", "k_finger", factor=30.0),
    },
    "sensor": {"mass": Quantity("mass_kg", "m_sensor", factor=3.0)},
}
"""Quantities by part and key. A sensor is no part of a device; its mass comes with the measurements."""


@dataclass(frozen=True)
class Parameter:
    """One number to be fitted within `low` and `high`, in SI; the `actuators` (indices) share it.

    The fit works on its coordinate: the natural logarithm, or asinh(value / 2 knee) of a damping, which may be 0.
    """

    name: str
    part: str
    key: str
    actuators: tuple[int, ...]
    start: float
    low: float
    high: float
    knee: float

    @property
    def quantity(self) -> Quantity:
        """The quantity of the device that is fitted."""
        return QUANTITIES[self.part][self.key]

    @property
    def unit(self) -> str:
        """SI unit of the value, as in a device file."""
        return FITTED_UNITS.get(f"{self.part}.{self.key}", _SENSOR_UNIT)

    @property
    def symbol(self) -> str:
        """The paper's letter, with the number of the actuator where each has its own value."""
        letter = self.quantity.letter
        return f"{letter}_{self.actuators[0] + 1}" if "[" in self.name else letter

    @property
    def is_damping(self) -> bool:
        """Whether the value may be 0."""
        return self.knee > 0

    @property
    def prior(self) -> float:
        """Standard deviation of the coordinate before any measurement: uniform within the bounds."""
        return (self.coordinate(self.high) - self.coordinate(self.low)) / math.sqrt(12)

    def coordinate(self, value: float) -> float:
        """Coordinate of an SI value."""
        return math.asinh(value / (2 * self.knee)) if self.is_damping else math.log(value)

    def value_at(self, coordinate: float) -> float:
        """The SI value at a coordinate."""
        return 2 * self.knee * math.sinh(coordinate) if self.is_damping else math.exp(coordinate)

    def rate_at(self, coordinate: float) -> float:
        """Derivative of the value by the coordinate."""
        return 2 * self.knee * math.cosh(coordinate) if self.is_damping else math.exp(coordinate)


def values_at(parameters: Sequence[Parameter], coordinate: Array) -> Array:
    """SI values (parameter,) at coordinates (parameter,)."""
    return np.array([p.value_at(x) for p, x in zip(parameters, coordinate.tolist(), strict=True)])


def rates_at(parameters: Sequence[Parameter], coordinate: Array) -> Array:
    """Derivatives (parameter,) of the values by the coordinates."""
    return np.array([p.rate_at(x) for p, x in zip(parameters, coordinate.tolist(), strict=True)])


def default_names(device: Device) -> tuple[str, ...]:
    """The first fit of one's own surface: the paper's parameters, each actuator's own full scale, Young's modulus.

    An alloy's modulus is known to some per cent, and 1 % of it moves every mode by 0.5 %. With the density it
    stands for the thickness too, since the motion depends on E h^3 and rho h alone. Actuators of one make differ by
    some per cent; a full scale that they share would leave that to the misfit, and a good surface would be doubted.
    """
    own = tuple(f"actuator[{i}].full_scale" for i in range(1, len(device.actuators) + 1))
    others = [name for name in paper_names(device) if not name.endswith(".full_scale")]
    return (*others, *own, f"{device.surface.kind}.youngs_modulus")


def paper_names(device: Device) -> tuple[str, ...]:
    """The paper's six, k_1, k_2, c, alpha, sigma, eta; c and alpha are shared where the actuators have equal values."""
    own = tuple(f"actuator[{i}].stiffness" for i in range(1, len(device.actuators) + 1))
    return (
        *own,
        *_shared(device, "damping"),
        *_shared(device, "full_scale"),
        f"{device.surface.kind}.mass_damping",
        f"{device.surface.kind}.stiffness_damping",
    )


def _shared(device: Device, key: str) -> tuple[str, ...]:
    values = [getattr(actuator, QUANTITIES["actuator"][key].field) for actuator in device.actuators]
    if max(values) - min(values) <= 1e-9 * max(values):
        return (f"actuator.{key}",)
    return tuple(f"actuator[{i}].{key}" for i in range(1, len(values) + 1))


def find_parameters(
    device: Device, names: Sequence[str], bounds: Mapping[str, Bounds], sensor_mass_kg: float
) -> tuple[Parameter, ...]:
    """Parameters by name, starting at the device's values. Raises ParameterError for names that cannot be fitted.

    `bounds` (SI) replace the usual ones; sensor.mass starts at `sensor_mass_kg`. A fit is of displacements behind the
    springs of grounded actuators: it refuses others.
    """
    for each in device.actuators:
        if each.is_inertial or each.is_force:
            what = "is inertial" if each.is_inertial else "has a force for its full scale"
            as_m = f"state full_scale as the force divided by the stiffness, '{1e6 * each.full_scale_m:.6g} um'"
            remedy = "take its values from its data sheet" if each.is_inertial else as_m
            raise ParameterError(f"{device.name}: {each.name} {what}, to which nothing is fitted; {remedy}")
    for name in bounds:
        if name not in names:
            raise ParameterError(f"{name}: has bounds but is not fitted; fitted are {', '.join(names)}")
    found = tuple(_find(device, name, bounds.get(name), sensor_mass_kg) for name in names)
    taken: dict[tuple[str, str, int], str] = {}
    for parameter in found:
        for place in parameter.actuators or (-1,):
            other = taken.setdefault((parameter.part, parameter.key, place), parameter.name)
            if other is not parameter.name:
                raise ParameterError(f"{parameter.name}: is fitted as {other} already; name one of the two")
    if not found:
        raise ParameterError("no parameter is named; name at least one to fit")
    return found


def parameter_unit(device: Device, name: str) -> str:
    """Unit of the named parameter. Raises ParameterError for a name that cannot be fitted."""
    part, _, key = _parse(device, name)
    return FITTED_UNITS.get(f"{part}.{key}", _SENSOR_UNIT)


def with_changes(device: Device, changes: Mapping[str, float]) -> Device:
    """The device with other values (SI) by name. Raises ParameterError for a name that cannot be fitted."""
    for name, value in changes.items():
        part, actuators, key = _parse(device, name)
        parameter = Parameter(name, part, key, actuators, value, value, value, 0.0)
        device = with_values(device, [parameter], np.array([value]))
    return device


def _find(device: Device, name: str, bounds: Bounds | None, sensor_mass_kg: float) -> Parameter:
    part, actuators, key = _parse(device, name)
    start = sensor_mass_kg if part == "sensor" else _read(device, part, key, actuators)
    low, high = bounds or _usual_bounds(name, QUANTITIES[part][key], start)
    knee = QUANTITIES[part][key].knee
    if not (0 <= low < high < math.inf) or (low == 0 and not knee):
        expected = f"expected two rising values {'of at least' if knee else 'above'} 0"
        raise ParameterError(f"{name}: bounds {low:g} to {high:g}: {expected}")
    return Parameter(name, part, key, actuators, min(max(start, low), high), low, high, knee)


def _parse(device: Device, name: str) -> tuple[str, tuple[int, ...], str]:
    """Part, indices of its actuators, and key of a name."""
    match = re.fullmatch(r"(\w+)(?:\[(\d+)\])?\.(\w+)", name)
    known = known_names(device)
    if match is None or name not in known:
        near = difflib.get_close_matches(name, known, 1)
        hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}"
        hint = next((text.format(device.surface.kind) for end, text in _RULED.items() if name.endswith(end)), hint)
        raise ParameterError(f"{name!r}: cannot be fitted to {device.name}; {hint}")
    part, index, key = match.groups()
    if part != "actuator":
        return part, (), key
    return part, tuple(range(len(device.actuators))) if index is None else (int(index) - 1,), key


def known_names(device: Device) -> list[str]:
    """Every name that can be fitted to this device."""
    names: list[str] = []
    for part, keys in QUANTITIES.items():
        if part in ("bar", "plate") and part != device.surface.kind:
            continue
        prefixes = [part, *(f"{part}[{i}]" for i in range(1, len(device.actuators) + 1))] if part == "actuator" else []
        names += [
            f"{prefix}.{key}"
            for prefix in prefixes or [part]
            for key in keys
            if key != "clamp" or device.surface.kind == "bar"
        ]
    return names


def _usual_bounds(name: str, quantity: Quantity, start: float) -> Bounds:
    if quantity.knee:
        return 0.0, max(quantity.greatest, 10 * start)
    if start <= 0:
        raise ParameterError(f"{name}: is 0 in the description, which says no range; give bounds for it")
    return start / quantity.factor, min(start * quantity.factor, quantity.greatest or math.inf)


def _read(device: Device, part: str, key: str, actuators: tuple[int, ...]) -> float:
    field = QUANTITIES[part][key].field
    if part != "actuator":
        return float(getattr(device.surface if part == device.surface.kind else getattr(device, part), field))
    values = [float(getattr(device.actuators[i], field)) for i in actuators]
    return math.prod(values) ** (1 / len(values)) if min(values) > 0 else 0.0


def with_values(device: Device, parameters: Sequence[Parameter], values: Array) -> Device:
    """The device with these values (parameter,) in SI; the mass of a sensor is no part of it and is ignored."""
    kind = device.surface.kind
    parts: dict[str, dict[str, Any]] = {kind: {}, "finger": {}}
    actuators: list[dict[str, Any]] = [{} for _ in device.actuators]
    for parameter, value in zip(parameters, values.tolist(), strict=True):
        field = parameter.quantity.field
        for i in parameter.actuators:
            actuators[i][field] = value
        if parameter.part in parts:
            parts[parameter.part][field] = value
    return replace(
        device,
        surface=replace(device.surface, **parts[kind]),
        finger=replace(device.finger, **parts["finger"]),
        actuators=tuple(replace(a, **changes) for a, changes in zip(device.actuators, actuators, strict=True)),
    )
