"""Misfit between predicted and measured accelerations, with its derivatives."""

from dataclasses import dataclass

import numpy as np

from base.arrays import Array, Complex
from precompute.measurements.model import MeasurementModel
from precompute.measurements.parameters import Parameter, rates_at, values_at
from precompute.measurements.types import Kind, Measurements


@dataclass(frozen=True)
class Misfit:
    """Residuals (datum,), predicted minus measured, and their derivatives (datum, parameter) by the coordinates.

    log_: of logarithms of accelerations, a response's phase in radians. A peak is one datum, a response two, all real
    parts before all imaginary ones.
    """

    log_residual: Array
    log_slope: Array


class MisfitModel:
    """The misfit of measurements as a function of the coordinates of parameters (parameter,)."""

    def __init__(self, model: MeasurementModel, measurements: Measurements, parameters: tuple[Parameter, ...]) -> None:
        self._model, self.is_peak = model, measurements.kind is Kind.PEAK
        self._log_measured = np.log(measurements.acceleration)
        self._last: tuple[Array, Misfit] | None = None
        self.parameters, self.least_noise = parameters, 1e-8  # below which residuals are rounding errors of the model

    def at(self, coordinate: Array) -> Misfit:
        """The misfit at a coordinate; the last one is remembered."""
        if self._last is None or not np.array_equal(self._last[0], coordinate):
            self._last = (coordinate.copy(), self._compute(coordinate))
        return self._last[1]

    def _compute(self, coordinate: Array) -> Misfit:
        prediction = self._model.predict(values_at(self.parameters, coordinate))
        slope = prediction.by_parameter * rates_at(self.parameters, coordinate)
        difference = prediction.log_acceleration - self._log_measured
        turned = difference.real + 1j * ((difference.imag + np.pi) % (2 * np.pi) - np.pi)  # phases within half a turn
        return Misfit(log_residual=self._data(turned), log_slope=self._data(slope))

    def _data(self, value: Complex) -> Array:
        """Data along the first axis from the rows."""
        real: Array = value.real
        return real.copy() if self.is_peak else np.concatenate([real, value.imag])
