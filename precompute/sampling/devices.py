"""Sampling of a calibrated device: devices that its measurements do not tell apart."""

from dataclasses import replace

import numpy as np

from engine.device import Device, FittedValue, Uncertainty
from precompute.measurements.parameters import Parameter, find_parameters, values_at, with_values

_DRAWS_AT_ONCE = 16


def sample_devices(device: Device, uncertainty: Uncertainty, count: int, seed: int) -> list[Device]:
    """`count` devices that the measurements cannot tell from `device`, by a seed; fitted values vary together.

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
        devices.append(with_values(device, parameters, values_at(parameters, chosen)))
    return devices


def _parameters(device: Device, fitted: tuple[FittedValue, ...]) -> tuple[Parameter, ...]:
    bounds = {value.name: (value.low, value.high) for value in fitted}
    found = find_parameters(device, [value.name for value in fitted], bounds, 0.0)
    return tuple(replace(parameter, knee=value.knee) for parameter, value in zip(found, fitted, strict=True))
