"""The paper's procedure, for comparison: fit each drive alone by its L1 objective (12), then average."""

from dataclasses import dataclass

import numpy as np

from base.arrays import Array, Complex
from engine.device import Device
from precompute.calibration.calibrate import Calibration, names_told, pose_fit
from precompute.calibration.fit import fit
from precompute.calibration.misfit import Loss
from precompute.measurements.model import MeasurementModel
from precompute.measurements.parameters import Parameter
from precompute.measurements.types import Kind, Measurements

_MOST_DRIVES = 24  # a fit for each: bounds the time of a comparison, whose answer is an average anyway


@dataclass(frozen=True)
class Pairwise:
    """Values (drive, parameter) from each drive alone, SI; `average` (parameter,) is the paper's estimate.

    The full scale of an actuator that stands still in a drive is NaN there.

    typical, total: median |ln(measured / predicted)| and sum |measured - predicted| in m/s^2 of all rows, for the
    average; `joint_typical`, `joint_total` for the one fit of all drives.
    """

    value: Array
    average: Array
    typical: float
    total: float
    joint_typical: float
    joint_total: float


def fit_pairwise(device: Device, calibration: Calibration) -> Pairwise | None:
    """Fit each drive alone; None with one drive or more than 24, or where a drive has too few rows."""
    measurements, parameters = calibration.measurements, calibration.parameters
    drive = measurements.drive_of_row
    drives = int(drive.max()) + 1
    readings = np.bincount(drive) * (2 if measurements.kind is Kind.RESPONSE else 1)
    if not 2 <= drives <= _MOST_DRIVES or readings.min() <= len(parameters):
        return None
    values = np.array([_fit_alone(device, measurements.part(drive == i), parameters) for i in range(drives)])
    average: Array = np.nanmean(values, axis=0)
    model = MeasurementModel(device, measurements, parameters)
    typical, total = _misfit(measurements, np.exp(model.predict(average).log_acceleration))
    joint_typical, joint_total = _misfit(measurements, calibration.predicted)
    return Pairwise(values, average, typical, total, joint_typical, joint_total)


def _fit_alone(device: Device, rows: Measurements, parameters: tuple[Parameter, ...]) -> list[float]:
    names = names_told(rows, [parameter.name for parameter in parameters])
    told = tuple(parameter for parameter in parameters if parameter.name in names)
    found = fit(pose_fit(device, rows, told), Loss.L1, starts=1, seed=0)
    value = {p.name: p.value_at(x) for p, x in zip(told, found.coordinate.tolist(), strict=True)}
    return [value.get(parameter.name, np.nan) for parameter in parameters]


def _misfit(measurements: Measurements, predicted: Complex) -> tuple[float, float]:
    measured = measurements.acceleration
    ratio = np.log(np.abs(measured) / np.abs(predicted))
    return float(np.median(np.abs(ratio))), float(np.abs(measured - predicted).sum())
