"""Misfit between predicted and measured accelerations, with its derivatives, and the losses that a fit minimises."""

from dataclasses import dataclass
from enum import Enum

import numpy as np

from base.arrays import Array, Complex
from precompute.measurements.model import MeasurementModel
from precompute.measurements.parameters import Parameter, rates_at, values_at
from precompute.measurements.types import Kind, Measurements


class Loss(Enum):
    """Loss of a fit: robust or plain least squares of log amplitudes, or the paper's sum of |difference| (12)."""

    ROBUST = "robust"
    SQUARES = "squares"
    L1 = "l1"


@dataclass(frozen=True)
class Misfit:
    """Residuals (datum,), predicted minus measured, and their derivatives (datum, parameter) by the coordinates.

    log_: of logarithms, a response's phase in radians; plain_: of accelerations in m/s^2. A peak is one datum, a
    response two, all real parts before all imaginary ones. size (datum,): predicted magnitude in m/s^2.
    """

    log_residual: Array
    log_slope: Array
    plain_residual: Array
    plain_slope: Array
    size: Array


class MisfitModel:
    """The misfit of measurements as a function of the coordinates of parameters (parameter,)."""

    def __init__(self, model: MeasurementModel, measurements: Measurements, parameters: tuple[Parameter, ...]) -> None:
        self._model, self.is_peak = model, measurements.kind is Kind.PEAK
        self._measured = measurements.acceleration
        self._log_measured = np.log(measurements.acceleration)
        self._last: tuple[Array, Misfit] | None = None
        self.parameters, self.least_noise = parameters, 1e-8  # below which residuals are rounding errors of the model
        self.mean_reading = float(np.abs(measurements.acceleration).mean())
        """Mean magnitude of the measured accelerations, m/s^2."""

    def at(self, coordinate: Array) -> Misfit:
        """The misfit at a coordinate; the last one is remembered."""
        if self._last is None or not np.array_equal(self._last[0], coordinate):
            self._last = (coordinate.copy(), self._compute(coordinate))
        return self._last[1]

    def _compute(self, coordinate: Array) -> Misfit:
        prediction = self._model.predict(values_at(self.parameters, coordinate))
        log = prediction.log_acceleration
        slope = prediction.by_parameter * rates_at(self.parameters, coordinate)
        predicted = np.exp(log)
        difference = log - self._log_measured
        turned = difference.real + 1j * ((difference.imag + np.pi) % (2 * np.pi) - np.pi)  # phases within half a turn
        return Misfit(
            log_residual=self._data(turned),
            log_slope=self._data(slope),
            plain_residual=self._data(predicted - self._measured),
            plain_slope=self._data(predicted[:, None] * slope),
            size=self._data(np.abs(predicted) * (1 + 1j)),
        )

    def _data(self, value: Complex) -> Array:
        """Data along the first axis from the rows."""
        real: Array = value.real
        return real.copy() if self.is_peak else np.concatenate([real, value.imag])
