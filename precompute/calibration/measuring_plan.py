"""Experiment design: what the data leave open, and the next readings that shrink the uncertainty most."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from base.arrays import Array, Points
from base.plain import to_plain
from base.points import clip_points, json_of, parts_of
from engine.device import Device
from precompute.calibration.calibrate import Calibration, FittedDevice
from precompute.measurements.model import MeasurementModel, even_places
from precompute.measurements.parameters import Bounds, Parameter, find_parameters, rates_at, values_at
from precompute.measurements.types import Kind, lay_out

LEAST_NOISE = 1e-3
"""Least relative noise of a reading that is assumed of any accelerometer."""
_FREQUENCIES = 49  # 97 leave errors 10 to 25 % smaller after 20 readings in 4 times the time, 25 up to 15 % greater
_POINTS = 23  # 12 mm apart on 280 mm; 12 or 45 leave errors within a sixth of these after 20 readings
_NOTHING = 1e-12  # m/s^2
_LEAST_APART_HZ = 10.0  # closer frequencies beat slowly, and their common peak takes long to come
_OPEN_BELOW = 2.0
"""Singular value below which a combination is open: the data narrow it to no less than half of its bounds."""
_PART = 0.25  # of a unit vector: smaller parts are not named
_NEARLY_ONE = 0.95  # of a unit vector: what the others have is then below 0.32 together


@dataclass(frozen=True)
class Accuracy:
    """Standard deviations of a reading: relative, of the sensor at rest, and of its place, which matters near nodes."""

    relative: float = 0.02
    floor_m_per_s2: float = 0.05
    place_m: float = 0.5e-3


@dataclass(frozen=True)
class Candidates:
    """Drives of one or two actuators, the others still, at every point.

    frequency_hz (drive, actuator): NaN where still; position_m (point,); slope (drive, point, parameter): derivative
    of ln peak acceleration by the coordinates, in standard deviations of that reading.
    """

    frequency_hz: Array
    position_m: Points
    slope: Array


@dataclass(frozen=True)
class Step:
    """One reading to take, and the standard deviations (parameter,) of the coordinates before and after it."""

    drive_hz: tuple[float, ...]
    position_m: complex
    before: Array
    after: Array


@dataclass(frozen=True)
class Plan:
    """Readings to take one after the other, for parameters at coordinates (parameter,)."""

    parameters: tuple[Parameter, ...]
    coordinate: Array
    steps: tuple[Step, ...]

    def summary(self) -> dict[str, Any]:
        """Plain values: standard errors in SI before and after, and the share by which each reading shrinks them."""
        each = list(zip(self.parameters, self.coordinate.tolist(), strict=True))
        before, after = self.steps[0].before, self.steps[-1].after
        return {
            "parameters": [
                {
                    "name": p.name,
                    "unit": p.unit,
                    "value": p.value_at(x),
                    "standard_error": float(before[i]) * p.rate_at(x),
                    "standard_error_after": float(after[i]) * p.rate_at(x),
                }
                for i, (p, x) in enumerate(each)
            ],
            "readings": [
                {
                    "drive_hz": to_plain(step.drive_hz),
                    "position_m": json_of(step.position_m),
                    "shrinks": {
                        p.name: float(1 - step.after[i] / step.before[i]) for i, p in enumerate(self.parameters)
                    },
                }
                for step in self.steps
            ],
        }


def plan_first(
    device: Device,
    names: Sequence[str],
    bounds: Mapping[str, Bounds],
    sensor_mass_kg: float,
    accuracy: Accuracy,
    count: int,
) -> Plan:
    """Plan before any measurement, from the description and the bounds alone."""
    parameters = find_parameters(device, names, bounds, sensor_mass_kg)
    coordinate = np.array([parameter.coordinate(parameter.start) for parameter in parameters])
    candidates = propose_candidates(device, parameters, coordinate, sensor_mass_kg, accuracy)
    steps = plan_readings(candidates, prior_information(parameters), count)
    return Plan(parameters, coordinate, tuple(steps))


def plan_after(calibration: Calibration, accuracy: Accuracy, count: int) -> Plan:
    """Plan after a calibration, with the noise of its measurements."""
    parameters, mass_kg = calibration.parameters, float(np.median(calibration.measurements.sensor_mass_kg))
    noisy = replace(accuracy, relative=max(calibration.noise, LEAST_NOISE))
    candidates = propose_candidates(calibration.device, parameters, calibration.coordinate, mass_kg, noisy)
    steps = plan_readings(candidates, calibration.information + prior_information(parameters), count)
    return Plan(parameters, calibration.coordinate, tuple(steps))


def propose_candidates(
    device: Device, parameters: tuple[Parameter, ...], coordinate: Array, sensor_mass_kg: float, accuracy: Accuracy
) -> Candidates:
    """Drives of one frequency or a pair, on a grid within the actuators' bands, at even points."""
    grid_hz = np.linspace(device.sweep.start_hz, device.sweep.stop_hz, _FREQUENCIES)
    position_m, corner_m = even_places(device, _POINTS), device.surface.corner_m
    size, rate = _single_responses(device, parameters, coordinate, sensor_mass_kg, grid_hz, position_m)
    beside = [
        _single_responses(device, (), np.zeros(0), sensor_mass_kg, grid_hz, clip_points(moved_m, corner_m))[0]
        for way in (1.0, 1j)[: len(parts_of(corner_m))]
        for moved_m in [position_m + way * accuracy.place_m]
    ]
    bands = np.array([actuator.band_hz for actuator in device.actuators])
    in_band = (grid_hz >= bands[:, :1] - 1e-9) & (grid_hz <= bands[:, 1:] + 1e-9)
    drives = [[(one, f)] for one, f in np.argwhere(in_band).tolist()]
    for one, other in itertools.combinations(range(len(bands)), 2):
        is_apart = np.abs(grid_hz[:, None] - grid_hz) >= _LEAST_APART_HZ
        pairs = np.argwhere(in_band[one][:, None] & in_band[other] & is_apart)
        drives += [[(one, first), (other, second)] for first, second in pairs.tolist()]
    frequency_hz = np.full((len(drives), len(bands)), np.nan)
    moved = np.zeros((len(drives), len(bands), len(grid_hz)))
    for row, drive in enumerate(drives):
        for actuator, f in drive:
            frequency_hz[row, actuator], moved[row, actuator, f] = grid_hz[f], 1.0
    # paper eq. (8): tones of different frequencies add as magnitudes
    total, total_rate, *totals_beside = (np.tensordot(moved, part, 2) for part in (size, rate, *beside))
    total = np.maximum(total, _NOTHING)
    displaced = sum(((each - total) / total) ** 2 for each in totals_beside)
    deviation = np.sqrt(accuracy.relative**2 + (accuracy.floor_m_per_s2 / total) ** 2 + displaced)
    return Candidates(frequency_hz, position_m, total_rate / (total * deviation)[..., None])


def _single_responses(
    device: Device,
    parameters: tuple[Parameter, ...],
    coordinate: Array,
    sensor_mass_kg: float,
    grid_hz: Array,
    position_m: Points,
) -> tuple[Array, Array]:
    """Magnitude (actuator, frequency, point) of one actuator alone, and its derivative (..., parameter)."""
    actuators, shape = len(device.actuators), (len(device.actuators), len(grid_hz), len(position_m))
    drives = np.full((actuators, len(grid_hz), actuators), np.nan)
    for i in range(actuators):
        drives[i, :, i] = grid_hz
    rows = lay_out(drives.reshape(-1, actuators), position_m, sensor_mass_kg, Kind.RESPONSE)
    found = MeasurementModel(device, rows, parameters).predict(values_at(parameters, coordinate))
    size = np.exp(found.log_acceleration.real)
    rate = size[:, None] * found.by_parameter.real * rates_at(parameters, coordinate)
    return size.reshape(shape), rate.reshape(*shape, len(parameters))


def plan_readings(candidates: Candidates, information: Array, count: int) -> list[Step]:
    """`count` readings, each the best after the ones before it; no reading is proposed twice.

    `information` (parameter, parameter) is that of the readings already taken.
    """
    _, points, parameters = candidates.slope.shape
    slope = candidates.slope.reshape(-1, parameters)
    left = np.ones(len(slope), dtype=np.bool_)
    covariance = np.linalg.inv(information)
    steps: list[Step] = []
    for _ in range(min(count, len(slope))):
        moved = slope @ covariance
        variance = np.einsum("cp,cp->c", moved, slope)
        # A reading divides the determinant of the covariance by 1 + variance (Sherman and Morrison): D-optimal.
        best = int(np.argmax(np.where(left, variance, -1.0)))
        left[best] = False
        before = np.sqrt(np.diag(covariance))
        covariance = covariance - np.outer(moved[best], moved[best]) / (1 + variance[best])
        drive, point = divmod(best, points)
        steps.append(
            Step(
                drive_hz=tuple(candidates.frequency_hz[drive].tolist()),
                position_m=candidates.position_m[point].item(),
                before=before,
                after=np.sqrt(np.diag(covariance)),
            )
        )
    return steps


def prior_information(parameters: Sequence[Parameter]) -> Array:
    """Information (parameter, parameter) of the bounds alone."""
    return np.diag([parameter.prior**-2.0 for parameter in parameters])


@dataclass(frozen=True)
class Combination:
    """A direction in parameter space that the data leave open; `singular_value` runs from 0 (wholly open) to 2.

    parts: of a unit vector by the name of the parameter, the greatest first.
    """

    singular_value: float
    parts: dict[str, float]
    text: str


def open_combinations(calibration: FittedDevice) -> tuple[Combination, ...]:
    """Open combinations, by singular values of the sensitivity scaled by the noise and the width of the bounds."""
    prior = np.array([parameter.prior for parameter in calibration.parameters])
    square, vector = np.linalg.eigh(calibration.information * np.outer(prior, prior))
    found: list[Combination] = []
    for value, direction in zip(np.sqrt(np.maximum(square, 0.0)).tolist(), vector.T, strict=True):
        if value >= _OPEN_BELOW:
            break
        signed = direction * np.sign(direction[np.argmax(np.abs(direction))])
        named = [
            (p.name, float(part)) for p, part in zip(calibration.parameters, signed, strict=True) if abs(part) > _PART
        ]
        parts = dict(sorted(named, key=lambda item: -abs(item[1])))
        found.append(Combination(value, parts, _words(parts)))
    return tuple(found)


def _words(parts: dict[str, float]) -> str:
    (first, size), *others = parts.items()
    if not others or size > _NEARLY_ONE:
        return f"{first} alone: it hardly changes what was measured"
    moves = " and ".join(f"{name} {'up' if part > 0 else 'down'}" for name, part in others)
    return f"{first} up with {moves}: together they hardly change what was measured"
