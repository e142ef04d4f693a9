"""Measurements from named columns with units, as tables hold them, and units of responses as others write them."""

import re
import reprlib
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from base.arrays import Array, Complex, Points
from engine.device import Device
from engine.device.quantity import QuantityError, read_quantity
from precompute.measurements.types import Kind, MeasurementError, Measurements, check_measurements, nearest_actuator

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


_PARTS = "real", "imaginary", "magnitude", "phase"
_SINGLE = {
    "position": "m",
    "sensor mass": "kg",
    "finger position": "m",
    "force position": "m",
    "frequency": "Hz",
    "peak acceleration": "m/s^2",
} | {f"{name} {part}": "rad" if part == "phase" else unit for name, unit in QUANTITIES.items() for part in _PARTS}
_PER_ACTUATOR = {"frequency": "Hz", "amplitude": "", "phase": "rad"}
_MOTIONS = "acceleration", "velocity", "displacement"
_ANGLES = {"rad": 1.0, **dict.fromkeys(("deg", "degrees", "°"), np.pi / 180)}
_ACROSS = " across"
OPTIONAL = ("frequency", "amplitude", "phase", "finger position")
"""Columns whose cells may be empty: the actuator is still, or no finger is on the bar."""
SIMULATED = "SIMULATED"  # the word in a comment that marks simulated readings


def column_names(device: Device) -> dict[str, str]:
    """Every column that a file for this device may have, with its SI unit."""
    single = {each: unit for name, unit in _SINGLE.items() for each in place_columns(device, name)}
    return single | {f"{key} {a.name}": unit for key, unit in _PER_ACTUATOR.items() for a in device.actuators}


def place_columns(device: Device, name: str) -> tuple[str, ...]:
    """The columns of a place, `position` and on a plate `position across`; any other name alone."""
    is_two = name.endswith("position") and isinstance(device.surface.corner_m, complex)
    return (name, name + _ACROSS) if is_two else (name,)


def split_places(device: Device, name: str, place_m: Points) -> dict[str, Array]:
    """Split places (row,) into a column for each side of the surface, by name; NaN in a row without a place."""
    parts = (np.where(np.isnan(place_m), np.nan, part) for part in (place_m.real, place_m.imag))
    return dict(zip(place_columns(device, name), parts, strict=False))


def side_of(device: Device, name: str) -> float:
    """Length in metres of the side of the surface that a column of places runs along, of which it may be a share."""
    corner_m = device.surface.corner_m
    return corner_m.imag if name.endswith(_ACROSS) else corner_m.real


def join_places(columns: Mapping[str, Array], device: Device, name: str, source: str) -> Points | None:
    """Places (row,) of a file, None where it has none. Raises MeasurementError for one direction without the other."""
    own = place_columns(device, name)
    given = [columns[each] for each in own if each in columns]
    empty = {np.isnan(each).tobytes() for each in given}
    if given and (len(given) < len(own) or len(empty) > 1):
        columns_of = " and ".join(f"{each} (mm)" for each in own)
        raise MeasurementError(f"{source}: a place on a plate has two columns, {columns_of}; give both")
    return None if not given else given[0] if len(own) == 1 else given[0] + 1j * given[1]


def unit_scale(text: str, unit: str) -> float:
    """Factor that converts a column in the unit `text` to `unit`. Raises QuantityError."""
    if unit == "rad":
        if text not in _ANGLES:
            raise QuantityError(f"{text!r} is not an angle; expected rad or deg")
        return _ANGLES[text]
    if unit == "" and text == "1":
        return 1.0
    if unit == "m/s^2" and (found := read_response_unit(text)).quantity == "acceleration":
        return found.scale  # as others write them; elsewhere g is a mass
    return read_quantity(f"1 {text}", unit)


def read_column(name: str, text: str, unit: str) -> tuple[str, float]:
    """The name of a column of which `unit` is the SI unit, and the factor to SI from its own unit `text`.

    A response per newton is named after its unit: the acceleration in m/N is a receptance. Raises QuantityError.
    """
    quantity, _, part = name.partition(" ")
    if quantity not in QUANTITIES or unit == "rad":
        return name, unit_scale(text, unit)
    found = read_response_unit(text)
    if found.quantity != quantity and not (found.is_per_newton and quantity in _MOTIONS):
        raise QuantityError(f"{text!r} is the unit of {found.quantity}; expected {unit}")
    return f"{found.quantity} {part}", found.scale


def assemble_measurements(
    columns: Mapping[str, Array],
    device: Device,
    sensor_mass_kg: float,
    source: str,
    place: Callable[[int], str],
    *,
    is_simulated: bool,
) -> Measurements:
    """Build measurements from columns (row,) in SI, NaN where empty; `sensor_mass_kg` applies without such a column.

    Raises MeasurementError for a missing column and for impossible rows.
    """
    quantity, reading = _reading(columns, source)
    position_m = join_places(columns, device, "position", source)
    if position_m is None:
        raise MeasurementError(f"{source}: has no column 'position'; where the sensor was, such as position (mm)")
    rows = len(position_m)
    empty = np.full(rows, np.nan)
    finger_m = join_places(columns, device, "finger position", source)
    given_force_m = join_places(columns, device, "force position", source)
    frequency, amplitude, phase = (
        np.stack([columns.get(f"{key} {a.name}", empty) for a in device.actuators], axis=1) for key in _PER_ACTUATOR
    )
    if "frequency" in columns and given_force_m is not None and np.isnan(frequency).all():
        frequency[np.arange(rows), nearest_actuator(device, given_force_m)] = columns["frequency"]
    for i, actuator in enumerate(device.actuators):
        if f"amplitude {actuator.name}" not in columns:
            amplitude[:, i] = np.where(np.isnan(frequency[:, i]), 0.0, 1.0)
    halved = ~np.isnan(frequency) & np.isnan(amplitude)
    if halved.any():
        row, which = np.argwhere(halved)[0]
        name = f"amplitude {device.actuators[which].name}"
        raise MeasurementError(f"{source}: {place(int(row))}: {name}: is empty beside a frequency; give both or none")
    frequency = np.where(np.nan_to_num(amplitude) > 0, frequency, np.nan)
    amplitude = np.nan_to_num(amplitude) * np.exp(1j * np.nan_to_num(phase))
    order = 0 if quantity is None else list(QUANTITIES).index(quantity) % len(_MOTIONS)
    force_m = _force_places(columns, device, quantity, amplitude, given_force_m, source)
    return check_measurements(
        Measurements(
            kind=Kind.PEAK if quantity is None else Kind.RESPONSE,
            position_m=position_m,
            frequency_hz=frequency,
            amplitude=amplitude,
            sensor_mass_kg=columns.get("sensor mass", np.full(rows, sensor_mass_kg)),
            finger_m=empty if finger_m is None else finger_m,
            acceleration=to_acceleration(reading, order, np.nan_to_num(frequency).max(axis=1)),
            is_simulated=is_simulated,
            force_m=force_m,
        ),
        device,
        source,
        place,
    )


def _force_places(
    columns: Mapping[str, Array],
    device: Device,
    quantity: str | None,
    amplitude: Complex,
    force_m: Points | None,
    source: str,
) -> Points | None:
    """Place (row,) of the force of responses per newton: its own column, or the actuator whose frequency is given."""
    own = sorted(columns.keys() & {"force position", "frequency"})
    named = [f"frequency {actuator.name}" for actuator in device.actuators]
    if quantity is None or quantity in _MOTIONS:
        if own:
            text = f"belongs to responses per newton, such as (m/s^2/N); of full scale is '{named[0]}'"
            raise MeasurementError(f"{source}: {own[0]!r}: {text}")
        return None
    is_twice = "frequency" in own and bool(columns.keys() & set(named))
    if is_twice or np.isin(amplitude, (0, 1), invert=True).any() or (np.count_nonzero(amplitude, axis=1) != 1).any():
        raise MeasurementError(
            f"{source}: {quantity}: a response per newton has one force in each row, without amplitude and phase: "
            "one frequency, of the actuator where the force was, or 'frequency (Hz)' with 'force position (mm)'"
        )
    base_m = np.array([actuator.position_m for actuator in device.actuators])
    at_actuator: Points = base_m[amplitude.real.argmax(axis=1)]
    return at_actuator if force_m is None else force_m


def _reading(columns: Mapping[str, Array], source: str) -> tuple[str | None, Complex]:
    """The quantity of a response, None for peaks; and the readings (row,)."""
    is_peak = "peak acceleration" in columns
    given = [(part, quantity) for quantity in QUANTITIES for part in _PARTS if f"{quantity} {part}" in columns]
    if is_peak and not given:
        return None, columns["peak acceleration"].astype(np.complex128)
    found = dict(given)
    value = {part: columns[f"{quantity} {part}"] for part, quantity in given}
    if len(given) == 2 and not is_peak:
        if found.keys() == {"magnitude", "phase"}:
            return found["magnitude"], value["magnitude"] * np.exp(1j * value["phase"])
        if found.keys() == {"real", "imaginary"} and found["real"] == found["imaginary"]:
            return found["real"], value["real"] + 1j * value["imaginary"]
    raise MeasurementError(
        f"{source}: expected a column 'peak acceleration', or the two 'acceleration real' and 'acceleration "
        "imaginary' of one unit, or 'acceleration magnitude' and 'acceleration phase'"
    )
