"""Measured complex responses over frequency, actuator and place, and a plant that moves as they say.

The untouched surface moves as it was measured: cubic splines interpolate between frequencies, and the least bent fields
between places, on a bar natural splines. The model gives what a force at a finger does to the bar, and the rise times.
ESTIMATE: no better than the calibration.
"""

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from base.arrays import Array, Complex, Integers, Mask, Points
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
from precompute.model.assembly import assemble
from precompute.model.plant import Plant
from precompute.model.response import blocked_force, solve_response

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


@dataclass(frozen=True)
class MeasuredDrive:
    """What is known of a surface whose response to its actuators was measured.

    between (degree of freedom, place): fields of the plant that are 1 at one of the measured places (`Plant.through`).
    """

    responses: MeasuredResponses
    between: Array

    def at(self, frequency_hz: Array) -> tuple[Array, Complex]:
        """The fields between the measured places, and the displacements at these (`Plant.known_drive`)."""
        displacement: Complex = -self._over_frequency(frequency_hz) / (2 * np.pi * frequency_hz[:, None, None]) ** 2
        return self.between, displacement.transpose(2, 1, 0)

    @cached_property
    def _over_frequency(self) -> "CubicSpline[np.complex128]":
        """Spline over frequency of accelerations (actuator, place), m/s^2."""
        return CubicSpline(self.responses.frequency_hz, self.responses.acceleration)


def measured_plant(device: Device, responses: MeasuredResponses) -> Plant:
    """Assemble the plant of a device whose responses were measured."""
    plant = assemble(device)
    known = MeasuredDrive(responses, plant.through(responses.position_m))
    return replace(plant, known=known)  # type: ignore[type-var]  # every plant is a dataclass


@dataclass(frozen=True)
class InterpolationErrors:
    """Errors (actuator,) relative to the greatest response at the frequency. ESTIMATE.

    between_frequencies, between_places: greatest error, at the samples left out, of interpolation through the others;
    an upper bound for that through all. model: median over the frequencies of the distance between model and
    measurement, root mean square over the places; where it is large, what the model contributes is wrong as well.
    """

    between_frequencies: Array
    between_places: Array
    model: Array


def estimate_errors(device: Device, responses: MeasuredResponses) -> InterpolationErrors:
    """Compare splines through every other frequency and place with the others, and the model with all."""
    measured, hz, place_m = responses.acceleration, responses.frequency_hz, responses.position_m
    size = abs(measured).max(axis=2, keepdims=True)
    # Leave out every other frequency. Leave out every other place of a bar, every fourth of a plate.
    left_hz, left_m = slice(1, len(hz) - 1, 2), slice(1, len(place_m) - 1, 4 if np.iscomplexobj(place_m) else 2)
    kept_hz, kept_m = _without(len(hz), left_hz), _without(len(place_m), left_m)
    between_hz = CubicSpline(hz[kept_hz], measured[kept_hz])(hz[left_hz]) - measured[left_hz]
    plant = assemble(device)
    matrix = plant.sampler(place_m[left_m]).shapes(plant.through(place_m[kept_m]))
    between_m = measured[..., kept_m] @ matrix.T - measured[..., left_m]
    modelled = solve_response(plant, hz).acceleration(place_m)
    distance = np.sqrt((abs(modelled - measured) ** 2).mean(axis=2) / (abs(measured) ** 2).mean(axis=2))
    return InterpolationErrors(
        between_frequencies=(abs(between_hz) / size[left_hz]).max(axis=(0, 2)),
        between_places=(abs(between_m) / size).max(axis=(0, 2)),
        model=np.median(distance, axis=0),
    )


def _without(count: int, left_out: slice) -> Mask:
    kept = np.ones(count, dtype=np.bool_)
    kept[left_out] = False
    return kept
