"""Measured accelerations of a surface: what was driven, where and with what sensor it was measured, what was read."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from enum import Enum
from typing import Any

import numpy as np

from base.arrays import Array, Complex, Integers, Mask, Points
from base.errors import TactableError
from base.points import point_text
from engine.device import Device

Rows = Mask | Integers


class CalibrationError(TactableError, ValueError):
    """A calibration cannot be made as asked: its measurements, its parameters or its output folder are wrong."""


class MeasurementError(CalibrationError):
    """Measurements cannot be used; the message names the file, the place in it, the value and the remedy."""


MOST_M_S2 = 1e6  # limit of a reading: what is said to be more than 100 000 times gravity has another unit
MOST_KG = 1.0  # limit of the mass of a sensor
AT_ACTUATOR = 0.01  # of the length of the surface: how far a place may be from the actuator that it stands for


class Kind(Enum):
    """Kind of a reading: the peak that all tones reach together (paper eq. (8)), or the phasor of one tone."""

    PEAK = "peak acceleration"
    RESPONSE = "complex response"


@dataclass(frozen=True)
class Measurements:
    """A column for each quantity, a row for each acceleration that was read.

    position_m (row,): point of the sensor, complex on a plate. frequency_hz (row, actuator): NaN where the actuator is
    still. amplitude (row, actuator): complex, fractions of full scale. sensor_mass_kg (row,): mass of the sensor.
    finger_m (row,): point of a finger, NaN for none. acceleration (row,): m/s^2; a peak is real.

    force_m (row,): place of the force where the rows are responses per newton, None where actuators moved. Then the
    acceleration is that under 1 N, the actuators are still, and the frequency stands at the one next to the force.
    """

    kind: Kind
    position_m: Points
    frequency_hz: Array
    amplitude: Complex
    sensor_mass_kg: Array
    finger_m: Points
    acceleration: Complex
    is_simulated: bool  # whether the file marks the readings as SIMULATED
    force_m: Points | None = None

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.position_m)

    def part(self, rows: Rows) -> "Measurements":
        """The chosen rows."""
        columns: dict[str, Any] = {field.name: getattr(self, field.name) for field in fields(self)}
        chosen: dict[str, Any] = {name: each[rows] for name, each in columns.items() if isinstance(each, np.ndarray)}
        return replace(self, **chosen)

    @property
    def drive_of_row(self) -> Integers:
        """Shape (row,): number of each row's drive (frequencies and amplitudes), in the order of first appearance.

        A force at another place is another drive.
        """
        parts = [np.nan_to_num(self.frequency_hz), self.amplitude.real, self.amplitude.imag]
        parts += [] if self.force_m is None else [self.force_m.real[:, None], self.force_m.imag[:, None]]
        _, first, inverse = np.unique(np.hstack(parts), axis=0, return_index=True, return_inverse=True)
        rank = np.empty(len(first), dtype=np.int64)
        rank[np.argsort(first)] = np.arange(len(first))
        return rank[inverse.ravel()]

    def count_distinct(self) -> int:
        """Number of rows that differ in more than the acceleration: the others repeat one of them."""
        where = (self.position_m, np.nan_to_num(self.finger_m, nan=-1), self.sensor_mass_kg, self.drive_of_row)
        return len(np.unique(np.column_stack(where), axis=0))

    def drive_text(self, row: int) -> str:
        """The drive of a row in words, such as "150 Hz and 130 Hz" or "150 Hz at 60 % and still"."""
        if self.force_m is not None:
            return f"{np.nanmax(self.frequency_hz[row]):g} Hz, 1 N at {point_text(self.force_m[row], 4)}"
        return " and ".join(
            "still" if amplitude == 0 else f"{hz:g} Hz" + ("" if amplitude == 1 else f" at {100 * amplitude:.3g} %")
            for hz, amplitude in zip(self.frequency_hz[row], np.abs(self.amplitude[row]), strict=True)
        )


def lay_out(frequency_hz: Array, position_m: Points, sensor_mass_kg: float, kind: Kind = Kind.PEAK) -> Measurements:
    """Rows for every drive (drive, actuator) at every place (point,), measured with one roving sensor.

    A frequency of NaN means still, every other actuator moves at full scale. The accelerations are still to be read: 1.
    """
    each_hz = np.repeat(np.asarray(frequency_hz, dtype=np.float64), len(position_m), axis=0)
    each_m: Any = np.tile(position_m, len(frequency_hz))
    rows = len(each_hz)
    return Measurements(
        kind=kind,
        position_m=each_m,
        frequency_hz=each_hz,
        amplitude=np.where(np.isnan(each_hz), 0, 1).astype(np.complex128),
        sensor_mass_kg=np.full(rows, sensor_mass_kg),
        finger_m=np.full(rows, np.nan),
        acceleration=np.ones(rows, dtype=np.complex128),
        is_simulated=False,
    )


def check_measurements(
    measurements: Measurements, device: Device, source: str, place: Callable[[int], str]
) -> Measurements:
    """The measurements, every row checked; `place` names a row as the file does. Raises MeasurementError."""
    if not len(measurements):
        raise MeasurementError(f"{source}: has no measurement; give at least one acceleration")
    corner_m, kind = device.surface.corner_m, device.surface.kind
    hz, amplitude, read = measurements.frequency_hz, np.abs(measurements.amplitude), measurements.acceleration
    size = read.real if measurements.kind is Kind.PEAK else np.abs(read)
    mass_kg = measurements.sensor_mass_kg
    force_m = np.full(len(hz), np.nan) if measurements.force_m is None else measurements.force_m
    places: tuple[tuple[str, Points], ...] = (
        ("position", measurements.position_m),
        ("finger position", measurements.finger_m),
        ("force position", force_m),
    )
    for name, place_m in places:
        if (outside := is_outside(place_m, corner_m)).any():
            row = int(np.argmax(outside))
            on_it = f"expected 0 to {point_text(corner_m)}, the {kind}'s {'length' if kind == 'bar' else 'sides'}"
            raise MeasurementError(f"{source}: {place(row)}: {name}: {point_text(place_m[row])}: {on_it}")
    rules = (
        ("frequency", hz, "Hz", ((amplitude > 0) & ~((hz > 0) & np.isfinite(hz))), "expected more than 0 Hz"),
        ("amplitude", 100 * amplitude, "%", ~(amplitude <= 1 + 1e-9), "expected at most 100 % of full scale"),
        ("amplitude", 100 * amplitude, "%", np.all(amplitude == 0, axis=1), "no actuator moves; leave the row out"),
        ("sensor mass", 1e3 * mass_kg, "g", ~((mass_kg >= 0) & (mass_kg <= MOST_KG)), "expected 0 to 1000 g"),
        ("acceleration", size, "m/s^2", ~(size > 0), "expected more than 0; leave the row out"),
        ("acceleration", size, "m/s^2", ~(size <= MOST_M_S2), f"expected at most {MOST_M_S2:g}; leave the row out"),
    )
    for column, values, unit, is_bad, expected in rules:
        bad = is_bad if is_bad.ndim == 1 else is_bad.any(axis=1)
        if bad.any():
            row = int(np.argmax(bad))
            which = 0 if is_bad.ndim == 1 else int(np.argmax(is_bad[row]))
            value = values[row] if values.ndim == 1 else values[row, which]
            name = f"{column} {device.actuators[which].name}" if values.ndim == 2 else column
            raise MeasurementError(f"{source}: {place(row)}: {name}: {value:g} {unit}: {expected}")
    if measurements.kind is Kind.RESPONSE:
        moved = np.where(amplitude > 0, hz, np.nan)
        mixed = np.nanmin(moved, axis=1) != np.nanmax(moved, axis=1)
        if mixed.any():
            row = int(np.argmax(mixed))
            text = measurements.drive_text(row)
            raise MeasurementError(f"{source}: {place(row)}: frequency: {text}: a complex response has one frequency")
    return measurements


def nearest_actuator(device: Device, position_m: Points) -> Integers:
    """Index (place,) of the actuator that is nearest to each position (place,) in metres."""
    base_m = np.array([actuator.position_m for actuator in device.actuators])
    return np.abs(position_m[:, None] - base_m).argmin(axis=1)


def text_of_places(device: Device) -> str:
    """The actuators and their places in words, such as "left 45 mm, right 273 mm"."""
    return ", ".join(f"{actuator.name} {point_text(actuator.position_m)}" for actuator in device.actuators)


def is_outside(position_m: Points, corner_m: complex) -> Mask:
    """Whether each point (point,) lies beyond the edges of the surface that reaches from 0 to `corner_m`."""
    sides = (position_m.real, corner_m.real), (position_m.imag, corner_m.imag)
    along, across = ((part < 0) | (part > side * (1 + 1e-9)) for part, side in sides)
    return along | across
