"""Measured complex responses as an array over frequency, actuator and place, from which a table can be built."""

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from base.arrays import Array, Complex, Integers, Points
from base.points import point_text
from engine.device import Device
from precompute.measurements.measurement_file import read_measurements
from precompute.measurements.model import MeasurementModel
from precompute.measurements.types import (
    AT_ACTUATOR,
    Kind,
    MeasurementError,
    Measurements,
    nearest_actuator,
    text_of_places,
)
from precompute.model.response import blocked_force

FEWEST_PLACES = 4  # places that a cubic spline needs; a plate that moves as a whole is told by three
_SAME_HZ, _SAME_M = 1e-6, 1e-6
_SLACK = 1e-9


@dataclass(frozen=True)
class MeasuredResponses:
    """Acceleration of the untouched surface without the sensor's mass, one actuator at full scale and the others still.

    frequency_hz (frequency,), position_m (place,), rising; acceleration (frequency, actuator, place), m/s^2, complex.
    name: of the file; sha256: of its bytes. is_per_newton: the file is, and the model's blocked forces made it of full
    scale: levels are as good as the device file. ESTIMATE.
    """

    frequency_hz: Array
    position_m: Points
    acceleration: Complex
    name: str
    sha256: str
    is_simulated: bool
    is_per_newton: bool = False


def read_responses(
    path: Path, device: Device, sensor_mass_kg: float = 0.0, *, scales_forces: bool = False
) -> MeasuredResponses:
    """Read complex responses (tables/MEASUREMENTS.md) of every actuator alone at every frequency and place.

    scales_forces: responses per newton to forces at the actuators' places are multiplied by the actuators' forces.
    Raises MeasurementError where one is missing; OSError if the file does not exist.
    """
    measurements = read_measurements(path, device, sensor_mass_kg)
    _check_kind(measurements, device, str(path))
    measurements = replace(measurements, acceleration=_unloaded(device, measurements))
    if (measurements.force_m is not None) is not scales_forces:
        remedy = (
            "is of full scale already; leave --force-of-actuators out"
            if scales_forces
            else "is per newton; a table needs responses to the actuators at full scale. If the forces were where the "
            "actuators are, with these on the bar, --force-of-actuators multiplies by the force of each at full scale"
        )
        raise MeasurementError(f"{path}: {remedy}")
    if scales_forces:
        measurements = _scaled_by_forces(device, measurements, str(path))
    actuator = (np.abs(measurements.amplitude) > 0).argmax(axis=1)
    rows = np.arange(len(measurements))
    value = measurements.acceleration / measurements.amplitude[rows, actuator]
    frequency_hz, f = _axis(measurements.frequency_hz[rows, actuator], _SAME_HZ)
    position_m, p = _axis(measurements.position_m, _SAME_M)
    acceleration = np.full((len(frequency_hz), len(device.actuators), len(position_m)), np.nan, dtype=np.complex128)
    if len(set(zip(f.tolist(), actuator.tolist(), p.tolist(), strict=True))) < len(measurements):
        raise MeasurementError(f"{path}: reads one actuator at one frequency and place twice; leave one out")
    acceleration[f, actuator, p] = value
    source = path.name, hashlib.sha256(path.read_bytes()).hexdigest(), measurements.is_simulated
    responses = MeasuredResponses(frequency_hz, position_m, acceleration, *source, scales_forces)
    _check_complete(responses, device, str(path))
    return responses


def _check_kind(measurements: Measurements, device: Device, source: str) -> None:
    if measurements.kind is not Kind.RESPONSE:
        raise MeasurementError(f"{source}: has peak accelerations; a table needs complex responses")
    if (~np.isnan(measurements.finger_m)).any():
        raise MeasurementError(f"{source}: has a finger on it; a table needs the untouched {device.surface.kind}")
    moving = (np.abs(measurements.amplitude) > 0).sum(axis=1)
    if (moving > 1).any():
        text = measurements.drive_text(int((moving > 1).argmax()))
        raise MeasurementError(f"{source}: {text}: moves more than one actuator; a table needs each alone")


def _scaled_by_forces(device: Device, measurements: Measurements, source: str) -> Measurements:
    """Responses to the actuators at full scale from those per newton to forces at their places.

    A force at the place of an actuator moves the surface on its mounts as the actuator does, whose force is that on
    one that is held. A hammer that roves while the sensor stays at an actuator reads the same: receptances are
    symmetric.
    """
    force_m, sensor_m = np.asarray(measurements.force_m), measurements.position_m
    base_m = np.array([actuator.position_m for actuator in device.actuators])
    is_off = [
        abs(each_m - base_m[nearest_actuator(device, each_m)]) > AT_ACTUATOR * device.surface.length_m
        for each_m in (force_m, sensor_m)
    ]
    if is_off[0].any() and is_off[1].any():
        raise MeasurementError(
            f"{source}: force at {point_text(force_m[int(is_off[0].argmax())], 4)}: is where no actuator is; they are "
            f"{text_of_places(device)}. A table needs all forces there, or all sensors; calibrate fits a device to any"
        )
    if is_off[0].any():
        force_m, sensor_m = sensor_m, force_m
    which, hz = nearest_actuator(device, force_m), np.nan_to_num(measurements.frequency_hz).max(axis=1)
    driven = which[:, None] == np.arange(len(base_m))
    force_n = blocked_force(device.actuators, hz)[np.arange(len(hz)), which]
    return replace(
        measurements,
        position_m=sensor_m,
        frequency_hz=np.where(driven, hz[:, None], np.nan),
        amplitude=driven.astype(np.complex128),
        acceleration=measurements.acceleration * force_n,
        force_m=None,
    )


def _unloaded(device: Device, measurements: Measurements) -> Complex:
    """Readings (row,) corrected by the model for the mass of the sensor. ESTIMATE."""
    if not (measurements.sensor_mass_kg > 0).any():
        return measurements.acceleration
    bare = replace(measurements, sensor_mass_kg=np.zeros(len(measurements)))
    with_sensor, without = (
        MeasurementModel(device, each, ()).predict(np.zeros(0)).log_acceleration for each in (measurements, bare)
    )
    return measurements.acceleration * np.exp(without - with_sensor)


def _axis(values: Any, same: float) -> tuple[Any, Integers]:
    """Distinct rising values, and the index of each value among them; values closer than `same` are equal."""
    rounded, index = np.unique(np.round(values / same), return_inverse=True)
    return rounded * same, index


def _check_complete(responses: MeasuredResponses, device: Device, source: str) -> None:
    hz, place_m = responses.frequency_hz, responses.position_m
    missing = np.argwhere(np.isnan(responses.acceleration))
    if len(missing):
        f, i, p = missing[0].tolist()
        raise MeasurementError(
            f"{source}: {device.actuators[i].name} at {hz[f]:g} Hz and {point_text(place_m[p])} is missing, "
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
