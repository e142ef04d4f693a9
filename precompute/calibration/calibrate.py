"""Calibration: fit the parameters of a device to measured accelerations, with an interval for each."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from threadpoolctl import threadpool_limits

from base.arrays import Array, Complex, Mask
from engine.device import Device, FittedValue, Uncertainty
from precompute.calibration.confidence import compute_confidence, compute_intervals
from precompute.calibration.fit import Fit, MisfitModel, Problem, fit, pose
from precompute.measurements.model import MeasurementModel
from precompute.measurements.parameters import Bounds, Parameter, default_names, find_parameters, with_values
from precompute.measurements.types import Kind, MeasurementError, Measurements

STARTS = 5  # 2 pass the tests too; a doubtful basin gets four times as many (fit.py)
MOST_READINGS = 10_000
"""A fit of 2000 readings takes 23 s of a processor; repeated readings say no more than their mean and scatter."""
OUTLIER = 4.0
"""Standard deviations of the noise beyond which a reading counts as wrong."""
_WITHIN_SENSOR = 0.01
"""A reading within 1 % of the fit is never wrong: accelerometers are not calibrated better than that."""
_AT_BOUND = 1e-3  # of the width of the bounds
_ROUGH_FACTOR = 2.0


class Known(Enum):
    """How well the data determine a parameter."""

    WELL = "known"
    ROUGHLY = "known within a factor"
    AT_MOST = "known only to be at most"
    AT_LEAST = "known only to be at least"
    NOT = "not identifiable"


@dataclass(frozen=True)
class Estimate:
    """One fitted parameter in SI: its value, standard error and 95 % confidence interval from `low` to `high`."""

    parameter: Parameter
    value: float
    standard_error: float
    low: float
    high: float
    known: Known


@dataclass(frozen=True)
class FittedDevice:
    """A device with fitted values, whatever they were fitted to.

    device: its text is still the old one. covariance, information (parameter, parameter): of the coordinates of the
    parameters; the information is that of the data alone, without the bounds. noise: relative standard deviation of a
    reading.
    """

    device: Device
    estimates: tuple[Estimate, ...]
    coordinate: Array
    covariance: Array
    information: Array
    noise: float

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters in the order of the estimates."""
        return tuple(estimate.parameter for estimate in self.estimates)

    @property
    def correlation(self) -> Array:
        """Correlation (parameter, parameter) of the coordinates."""
        deviation = np.sqrt(np.diag(self.covariance))
        out: Array = self.covariance / np.outer(deviation, deviation)
        return out

    @property
    def uncertainty(self) -> Uncertainty:
        """Bounds and covariance of the values that a device file holds, the mass of a sensor marginalised."""
        kept = [i for i, parameter in enumerate(self.parameters) if parameter.part != "sensor"]
        return Uncertainty(
            fitted=tuple(FittedValue(p.name, p.low, p.high, p.knee) for p in (self.parameters[i] for i in kept)),
            covariance=tuple(tuple(float(self.covariance[i, j]) for j in kept) for i in kept),
        )


@dataclass(frozen=True)
class Calibration(FittedDevice):
    """A device fitted to accelerations.

    predicted (row,): m/s^2. log_residual (row,): ln of measured over predicted magnitude. is_wrong (row,): readings
    that are further off than OUTLIER standard deviations and than _WITHIN_SENSOR.
    """

    measurements: Measurements
    predicted: Complex
    log_residual: Array
    is_wrong: Mask


def calibrate(
    device: Device,
    measurements: Measurements,
    parameters: Sequence[str] | None = None,
    *,
    bounds: Mapping[str, Bounds] | None = None,
    starts: int = STARTS,
    seed: int = 0,
) -> Calibration:
    """Fit `parameters` (names as in the device file; default: `default_names`) of `device` to `measurements`.

    Full scales that the rows do not tell (responses per newton, an actuator that stood still) are not fitted by
    default. `bounds` are SI. Raises ParameterError for names and bounds, MeasurementError where the rows determine
    nothing.

    >>> device = Device.read("reference-a.toml")
    >>> found = calibrate(device, read_measurements("measured.csv", device))
    >>> left = found.estimates[0]
    >>> left.parameter.name, 20e3 < left.low < left.value < left.high < 21e3, left.known.value
    ('actuator[1].stiffness', True, 'known')
    """
    names = names_told(measurements, default_names(device)) if parameters is None else tuple(parameters)
    chosen = find_parameters(device, names, bounds or {}, sensor_mass_of(measurements))
    with threadpool_limits(1, "blas"):  # unlimited BLAS is 100 times slower on a busy machine
        found = fit(pose_fit(device, measurements, chosen), starts, seed)
        fitted, residual = conclude(device, found), found.misfit.log_residual
        size = np.abs(residual)
        if measurements.kind is Kind.RESPONSE:
            size, residual = size.reshape(2, -1).max(axis=0), residual[: len(measurements)]
        model = MeasurementModel(device, measurements, fitted.parameters)
        values = np.array([estimate.value for estimate in fitted.estimates])
        return Calibration(
            **vars(fitted),
            measurements=measurements,
            predicted=np.exp(model.predict(values).log_acceleration),
            log_residual=-residual,
            is_wrong=size > max(OUTLIER * found.noise, _WITHIN_SENSOR),
        )


def names_told(measurements: Measurements, names: Sequence[str]) -> tuple[str, ...]:
    """The names without full scales that the rows do not tell: per newton, or of an actuator that stood still."""
    is_told = [measurements.force_m is None and bool(column.any()) for column in measurements.amplitude.T]
    untold = {f"actuator[{number}].full_scale" for number, told in enumerate(is_told, 1) if not told}
    untold |= set() if any(is_told) else {"actuator.full_scale"}
    return tuple(name for name in names if name not in untold) or tuple(names)


def pose_fit(device: Device, measurements: Measurements, parameters: tuple[Parameter, ...]) -> Problem:
    """The problem of the fit. Raises MeasurementError for too few or too many readings, or a parameter none shows."""
    if len(measurements) > MOST_READINGS:
        raise MeasurementError(
            f"there are {len(measurements)} readings; expected at most {MOST_READINGS}: take the mean of repeated "
            "ones, or fewer places"
        )
    model = MisfitModel(MeasurementModel(device, measurements, parameters), measurements, parameters)
    problem = pose(model)
    slope = model.at(problem.start).log_slope
    distinct = len(slope) * measurements.count_distinct() // len(measurements)
    if distinct <= len(parameters):
        repeated = "" if distinct == len(slope) else f", {distinct} without repetitions,"
        raise MeasurementError(
            f"{len(slope)} readings{repeated} cannot fit {len(parameters)} parameters; measure more or fit fewer"
        )
    for parameter, column in zip(parameters, slope.T, strict=True):
        if not column.any():
            raise MeasurementError(
                f"{parameter.name}: changes none of these readings (no finger, sensor or drive there); leave it out"
            )
    return problem


def sensor_mass_of(measurements: Measurements) -> float:
    """Mean mass of the sensors whose mass is not 0; 0 without such a sensor."""
    heavy = measurements.sensor_mass_kg[measurements.sensor_mass_kg > 0]
    return float(heavy.mean()) if len(heavy) else 0.0


def conclude(device: Device, found: Fit) -> FittedDevice:
    """The device at the minimum of a fit, with the interval of every value."""
    confidence = compute_confidence(found)
    intervals, parameters = compute_intervals(found, confidence), found.problem.misfit.parameters
    deviation = np.sqrt(np.diag(confidence.covariance))
    estimates = tuple(
        _estimate(parameter, x, sd, ends)
        for parameter, x, sd, ends in zip(
            parameters, found.coordinate.tolist(), deviation.tolist(), intervals.tolist(), strict=True
        )
    )
    return FittedDevice(
        device=with_values(device, parameters, np.array([estimate.value for estimate in estimates])),
        estimates=estimates,
        coordinate=found.coordinate,
        covariance=confidence.covariance,
        information=confidence.information,
        noise=found.noise,
    )


def _estimate(parameter: Parameter, coordinate: float, deviation: float, ends: Sequence[float]) -> Estimate:
    value, low, high = (parameter.value_at(x) for x in (coordinate, *ends))
    return Estimate(parameter, value, deviation * parameter.rate_at(coordinate), low, high, _known(parameter, ends))


def _known(parameter: Parameter, ends: Sequence[float]) -> Known:
    low, high = (parameter.coordinate(bound) for bound in (parameter.low, parameter.high))
    near = _AT_BOUND * (high - low)
    at_low, at_high = ends[0] <= low + near, ends[1] >= high - near
    if at_low or at_high:
        return Known.NOT if at_low and at_high else Known.AT_MOST if at_low else Known.AT_LEAST
    return Known.WELL if ends[1] - ends[0] <= 2 * np.log(_ROUGH_FACTOR) else Known.ROUGHLY
