"""Measured complex responses as an array over frequency, actuator and place, from which a table can be built."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from engine.device import Device
from precompute.measurements.file import read_measurements
from precompute.measurements.model import MeasurementModel
from precompute.measurements.types import Kind, MeasurementError, Measurements

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

FEWEST_PLACES = 4
"""Places that a cubic spline needs."""
_SAME_HZ, _SAME_M = 1e-6, 1e-6
_SLACK = 1e-9


@dataclass(frozen=True)
class MeasuredResponses:
    """Acceleration of the untouched bar without the sensor's mass, one actuator at full scale and the others still.

    frequency_hz (frequency,), position_m (place,), rising; acceleration (frequency, actuator, place), m/s^2, complex.
    name: of the file; sha256: of its bytes.
    """

    frequency_hz: Array
    position_m: Array
    acceleration: Complex
    name: str
    sha256: str
    is_simulated: bool


def read_responses(path: Path, device: Device, sensor_mass_kg: float = 0.0) -> MeasuredResponses:
    """Read complex responses (tables/MEASUREMENTS.md) of every actuator alone at every frequency and place.

    Raises MeasurementError where one is missing; OSError if the file does not exist.
    """
    measurements = read_measurements(path, device, sensor_mass_kg)
    _check_kind(measurements, str(path))
    actuator = (np.abs(measurements.amplitude) > 0).argmax(axis=1)
    rows = np.arange(len(measurements))
    value = _unloaded(device, measurements) / measurements.amplitude[rows, actuator]
    frequency_hz, f = _axis(measurements.frequency_hz[rows, actuator], _SAME_HZ)
    position_m, p = _axis(measurements.position_m, _SAME_M)
    acceleration = np.full((len(frequency_hz), len(device.actuators), len(position_m)), np.nan, dtype=np.complex128)
    if len(set(zip(f.tolist(), actuator.tolist(), p.tolist(), strict=True))) < len(measurements):
        raise MeasurementError(f"{path}: reads one actuator at one frequency and place twice; leave one out")
    acceleration[f, actuator, p] = value
    responses = MeasuredResponses(
        frequency_hz,
        position_m,
        acceleration,
        path.name,
        hashlib.sha256(path.read_bytes()).hexdigest(),
        measurements.is_simulated,
    )
    _check_complete(responses, device, str(path))
    return responses


def _check_kind(measurements: Measurements, source: str) -> None:
    if measurements.kind is not Kind.RESPONSE:
        raise MeasurementError(f"{source}: has peak accelerations; a table needs complex responses")
    if (~np.isnan(measurements.finger_m)).any():
        raise MeasurementError(f"{source}: has a finger on the bar; a table needs the untouched bar")
    moving = (np.abs(measurements.amplitude) > 0).sum(axis=1)
    if (moving > 1).any():
        text = measurements.drive_text(int((moving > 1).argmax()))
        raise MeasurementError(f"{source}: {text}: moves more than one actuator; a table needs each alone")


def _unloaded(device: Device, measurements: Measurements) -> Complex:
    """Readings (row,) corrected by the model for the mass of the sensor. ESTIMATE."""
    if not (measurements.sensor_mass_kg > 0).any():
        return measurements.acceleration
    bare = Measurements(**{**vars(measurements), "sensor_mass_kg": np.zeros(len(measurements))})
    with_sensor, without = (
        MeasurementModel(device, each, ()).predict(np.zeros(0)).log_acceleration for each in (measurements, bare)
    )
    unloaded: Complex = measurements.acceleration * np.exp(without - with_sensor)
    return unloaded


def _axis(values: Array, same: float) -> tuple[Array, NDArray[np.int64]]:
    """Distinct rising values, and the index of each value among them; values closer than `same` are equal."""
    rounded, index = np.unique(np.round(values / same), return_inverse=True)
    return rounded * same, index


def _check_complete(responses: MeasuredResponses, device: Device, source: str) -> None:
    hz, place_m = responses.frequency_hz, responses.position_m
    missing = np.argwhere(np.isnan(responses.acceleration))
    if len(missing):
        f, i, p = missing[0].tolist()
        raise MeasurementError(
            f"{source}: {device.actuators[i].name} at {hz[f]:g} Hz and {1e3 * place_m[p]:g} mm is missing, "
            f"the first of {len(missing)}; measure every actuator at every frequency and place"
        )
    if len(place_m) < FEWEST_PLACES:
        raise MeasurementError(f"{source}: has {len(place_m)} places; measure at {FEWEST_PLACES} or more")
    low_hz, high_hz = device.sweep.start_hz, device.sweep.stop_hz
    if hz[0] > low_hz * (1 + _SLACK) or hz[-1] < high_hz * (1 - _SLACK):
        raise MeasurementError(
            f"{source}: reaches from {hz[0]:g} to {hz[-1]:g} Hz, the device's sweep from {low_hz:g} to {high_hz:g} Hz; "
            "measure all of it or sweep less"
        )
