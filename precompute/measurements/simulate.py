"""Simulated measurements of a device with known parameters, with seeded noise and wrong readings."""

from dataclasses import dataclass, replace

import numpy as np

from base.arrays import Points
from engine.device import Device
from precompute.measurements.model import MeasurementModel
from precompute.measurements.types import Kind, Measurements

POINTS = 22  # measured points along the bar, as in the paper
_FIRST, _LAST = 0.02, 0.98  # fractions of each side: the middle of a sensor cannot be at the edge
_WRONG = 3.0  # a wrong range of the sensor; four standard deviations (OUTLIER) at 27 % noise


@dataclass(frozen=True)
class Flaws:
    """Relative standard deviation of a reading, and the share of readings that are 3 times too high or too low."""

    noise: float = 0.0
    wrong: float = 0.0


def even_places(device: Device, points: int = POINTS) -> Points:
    """Points (point,), evenly over the part of the surface that the middle of a sensor reaches.

    On a plate they are rows and columns, about as far apart; at most `points` of them.
    """
    corner_m = device.surface.corner_m
    rows = max(1, round((points * corner_m.imag / corner_m.real) ** 0.5))
    x_m = np.linspace(_FIRST, _LAST, points // rows) * corner_m.real
    y_m = np.linspace(_FIRST, _LAST, rows) * corner_m.imag
    return (x_m + 1j * y_m[:, None]).ravel() if isinstance(corner_m, complex) else x_m


def simulate_measurements(device: Device, layout: Measurements, flaws: Flaws, seed: int) -> Measurements:
    """The rows of `layout` with the readings that the device would give, flawed by a generator with this seed."""
    random = np.random.default_rng(seed)
    true = np.exp(MeasurementModel(device, layout, ()).predict(np.zeros(0)).log_acceleration)
    rows = len(layout)
    noise = random.standard_normal(rows)
    if layout.kind is Kind.RESPONSE:
        noise = (noise + 1j * random.standard_normal(rows)).astype(np.complex128)
    factor = np.exp(flaws.noise * noise)
    wrong = random.permutation(rows)[: round(flaws.wrong * rows)]
    factor[wrong] *= np.where(random.random(len(wrong)) < 0.5, _WRONG, 1 / _WRONG)
    return replace(layout, acceleration=true * factor, is_simulated=True)
