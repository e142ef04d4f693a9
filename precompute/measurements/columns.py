"""Measurements from named columns with units, as CSV and NetCDF files hold them (tables/MEASUREMENTS.md)."""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from engine.device import Device
from engine.device.quantity import QuantityError, read_quantity
from precompute.measurements.types import Kind, MeasurementError, Measurements, check_measurements

Array = NDArray[np.float64]

_SINGLE = {
    "position": "m",
    "sensor mass": "kg",
    "finger position": "m",
    "peak acceleration": "m/s^2",
    "acceleration real": "m/s^2",
    "acceleration imaginary": "m/s^2",
    "acceleration magnitude": "m/s^2",
    "acceleration phase": "rad",
}
_PAIRS = ("real", "imaginary"), ("magnitude", "phase")
"""The two ways in which columns may give complex accelerations."""
_PER_ACTUATOR = {"frequency": "Hz", "amplitude": "", "phase": "rad"}
_ANGLES = {"rad": 1.0, "deg": np.pi / 180}
OPTIONAL = ("frequency", "amplitude", "phase", "finger position")
"""Columns whose cells may be empty: the actuator is still, or no finger is on the bar."""
SIMULATED = "SIMULATED"
"""The word in a comment or an attribute that marks simulated readings."""


def column_names(device: Device) -> dict[str, str]:
    """Every column that a file for this device may have, with its SI unit."""
    own = {f"{key} {a.name}": unit for key, unit in _PER_ACTUATOR.items() for a in device.actuators}
    return _SINGLE | own


def unit_scale(text: str, unit: str) -> float:
    """Factor that converts a column in the unit `text` to `unit`. Raises QuantityError."""
    if unit == "rad":
        if text not in _ANGLES:
            raise QuantityError(f"{text!r} is not an angle; expected rad or deg")
        return _ANGLES[text]
    if unit == "" and text == "1":
        return 1.0
    if unit == "m/s^2":  # as others write them; elsewhere g is a mass
        text = "g_0" if text == "g" else text.replace("²", "^2").replace("s2", "s^2")
    return read_quantity(f"1 {text}", unit)


def may_be_empty(name: str) -> bool:
    """Whether the column may have empty cells."""
    return name.startswith(OPTIONAL)


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
    kind = _kind(columns, source)
    if "position" not in columns:
        raise MeasurementError(
            f"{source}: has no column 'position'; it says where the sensor was, such as position (mm)"
        )
    rows = len(columns["position"])
    empty = np.full(rows, np.nan)
    frequency, amplitude, phase = (
        np.stack([columns.get(f"{key} {a.name}", empty) for a in device.actuators], axis=1) for key in _PER_ACTUATOR
    )
    for i, actuator in enumerate(device.actuators):
        if f"amplitude {actuator.name}" not in columns:
            amplitude[:, i] = np.where(np.isnan(frequency[:, i]), 0.0, 1.0)
    halved = ~np.isnan(frequency) & np.isnan(amplitude)
    if halved.any():
        row, which = np.argwhere(halved)[0]
        name = f"amplitude {device.actuators[which].name}"
        raise MeasurementError(f"{source}: {place(int(row))}: {name}: is empty beside a frequency; give both or none")
    if kind is Kind.PEAK:
        acceleration = columns["peak acceleration"].astype(np.complex128)
    elif "acceleration real" in columns:
        acceleration = columns["acceleration real"] + 1j * columns["acceleration imaginary"]
    else:
        acceleration = columns["acceleration magnitude"] * np.exp(1j * columns["acceleration phase"])
    amplitude = np.nan_to_num(amplitude)
    return check_measurements(
        Measurements(
            kind=kind,
            position_m=columns["position"],
            frequency_hz=np.where(amplitude > 0, frequency, np.nan),
            amplitude=amplitude * np.exp(1j * np.nan_to_num(phase)),
            sensor_mass_kg=columns.get("sensor mass", np.full(rows, sensor_mass_kg)),
            finger_m=columns.get("finger position", empty),
            acceleration=acceleration,
            is_simulated=is_simulated,
        ),
        device,
        source,
        place,
    )


def _kind(columns: Mapping[str, Array], source: str) -> Kind:
    parts = [[f"acceleration {part}" in columns for part in pair] for pair in _PAIRS]
    complete, begun = sum(map(all, parts)), sum(map(any, parts))
    if "peak acceleration" in columns and not begun:
        return Kind.PEAK
    if complete == begun == 1 and "peak acceleration" not in columns:
        return Kind.RESPONSE
    raise MeasurementError(
        f"{source}: expected a column 'peak acceleration', or the two 'acceleration real' and 'acceleration "
        "imaginary', or 'acceleration magnitude' and 'acceleration phase'"
    )
