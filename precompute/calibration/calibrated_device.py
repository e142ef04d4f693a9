"""A calibration to a device description with the fitted values, and a device to the devices that it may be."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import tomlkit
from numpy.typing import NDArray

from engine.device import Device, FittedValue, Uncertainty
from precompute.calibration.calibrate import Calibration
from precompute.calibration.quantity_text import quantity_text
from precompute.measurements.parameters import Parameter, find_parameters, with_values

Array = NDArray[np.float64]

_DIGITS = 10
_DRAWS_AT_ONCE = 16


def calibrated_text(calibration: Calibration, provenance: Mapping[str, str]) -> str:
    """The description with the fitted values, comments kept, fitted keys no longer marked as estimates.

    Its [calibration] table says which were fitted and how well; `provenance` (created, measurements, sha256, report,
    loss) goes there as it is.
    """
    document = tomlkit.parse(calibration.device.text)
    for estimate in calibration.estimates:
        parameter = estimate.parameter
        if parameter.part == "sensor":
            continue
        value = quantity_text(estimate.value, parameter.unit, _DIGITS)
        for table in _tables(document, parameter):
            table[parameter.key] = value
            marks = table.get("inferred")
            if marks is not None and parameter.key in marks:
                marks.remove(parameter.key)
    document["calibration"] = _calibration_table(calibration, provenance)
    return tomlkit.dumps(document)


def calibrated_device(calibration: Calibration) -> Device:
    """The device with the fitted values and a description that says them: to build a table, or to write to a file."""
    provenance = {"loss": calibration.loss.value}
    return Device.parse(calibrated_text(calibration, provenance), calibration.device.name)


def _tables(document: Any, parameter: Parameter) -> list[Any]:
    if parameter.part == "actuator":
        return [document["actuator"][i] for i in parameter.actuators]
    return [document[parameter.part]]


def _calibration_table(calibration: Calibration, provenance: Mapping[str, str]) -> Any:
    table = tomlkit.table()
    for key, text in provenance.items():
        table[key] = text
    uncertainty = calibration.uncertainty
    covariance = tomlkit.array()
    for row in uncertainty.covariance:
        covariance.add_line([float(value) for value in row])
    covariance.add_line(indent="")
    table["covariance"] = covariance
    fitted = tomlkit.aot()
    units = {parameter.name: parameter.unit for parameter in calibration.parameters}
    for value in uncertainty.fitted:
        entry = tomlkit.table()
        entry["name"] = value.name
        for key in ("low", "high", *(("knee",) if value.knee else ())):
            entry[key] = quantity_text(getattr(value, key), units[value.name], _DIGITS)
        fitted.append(entry)
    table["fitted"] = fitted
    return table


def sample_devices(device: Device, uncertainty: Uncertainty, count: int, seed: int) -> list[Device]:
    """`count` devices that the measurements do not tell from `device`, seeded; what was fitted varies together.

    Coordinates are normal about the device's values, with the covariance of the calibration, within its bounds.
    """
    parameters = _parameters(device, uncertainty.fitted)
    centre, low, high = np.array([[p.coordinate(value) for value in (p.start, p.low, p.high)] for p in parameters]).T
    square, vector = np.linalg.eigh(np.array(uncertainty.covariance))
    root = vector * np.sqrt(np.maximum(square, 0.0))
    random = np.random.default_rng(seed)
    devices = []
    for _ in range(count):
        draws = centre + random.standard_normal((_DRAWS_AT_ONCE, len(centre))) @ root.T
        inside = np.flatnonzero(((draws >= low) & (draws <= high)).all(axis=1))
        chosen = np.clip(draws[inside[0] if len(inside) else 0], low, high)
        values = np.array([p.value_at(x) for p, x in zip(parameters, chosen.tolist(), strict=True)])
        devices.append(with_values(device, parameters, values))
    return devices


def _parameters(device: Device, fitted: tuple[FittedValue, ...]) -> tuple[Parameter, ...]:
    bounds = {value.name: (value.low, value.high) for value in fitted}
    found = find_parameters(device, [value.name for value in fitted], bounds, 0.0)
    return tuple(replace(parameter, knee=value.knee) for parameter, value in zip(found, fitted, strict=True))
