"""Fit of a device to natural frequencies and damping ratios alone.

Theory of operation. The model's modes are the complex poles of the untouched surface on its mounts, with the mass of a
sensor where it lay; dampers at the mounts make them non-proportional. Measured modes are paired with them, each with
another one, by frequency and, where shapes are given, by the modal assurance criterion; modes between may be missing.
The residuals are differences of ln frequency and ln damping ratio. Each is weighted by its stated error, in units of
the typical error of a frequency, below which the noise is not taken to be. Pole derivatives are those of Lancaster
(Lambda-matrices and Vibrating Systems, 1966): the matrices are symmetric.

Modes tell ratios: of stiffnesses to masses and of dampings to masses. No mode changes with a full scale.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.special import chdtrc
from threadpoolctl import threadpool_limits

from base.arrays import Array, Complex, Integers
from base.plain import to_plain
from engine.device import Device, Finger
from precompute.calibration.adequacy import SMALLEST_MISFIT, UNLIKELY
from precompute.calibration.calibrate import STARTS, FittedDevice, conclude
from precompute.calibration.calibration_report import report_of_fit
from precompute.calibration.fit import Misfit, MisfitModel, fit, pose
from precompute.measurements.measured_modes import DAMPING_ERROR, Modes
from precompute.measurements.model import force_slopes
from precompute.measurements.parameters import (
    Bounds,
    Parameter,
    default_names,
    find_parameters,
    rates_at,
    values_at,
    with_values,
)
from precompute.measurements.types import MeasurementError
from precompute.model.assembly import assemble, free_surface
from precompute.model.modal import compute_basis, compute_modal_model
from precompute.model.plant import Plant

_BEYOND = 16  # model modes above the measured ones: some may be missing, and dampers couple with higher ones
_STILL = 1e-6  # share of a natural frequency below which a pole does not oscillate
_OVERDAMPED = 1e3  # distance by which a pole that does not oscillate is paired after all others
_LEAST_DAMPING = 1e-6  # a ratio; below it no measurement tells it from 0
_LEAST_ASSURANCE = 0.8  # modal assurance criterion; of different modes it is about 0
_RATIOS = (
    "actuator.full_scale alone: no mode changes with it, and it stays as it was. Modes tell ratios of stiffnesses and "
    "dampings to masses: a mass that is not fitted counts as the device file states it"
)


@dataclass(frozen=True)
class ModelModes:
    """Poles (mode,) of the model, rising, those that do not oscillate last; their fields (degree of freedom, mode).

    shape (place, mode): deflections where shapes were measured.
    """

    plant: Plant
    pole: Complex
    field: Complex
    shape: Complex


class ModesMisfit(MisfitModel):
    """The misfit of measured modes as a function of the coordinates of parameters (parameter,)."""

    def __init__(self, device: Device, modes: Modes, parameters: tuple[Parameter, ...]) -> None:
        self._device, self._modes, self._last, self._free = device, modes, None, free_surface(device)
        self.parameters, self.is_peak = parameters, True
        self.least_noise = float(np.median(modes.frequency_error))
        self._is_damped = ~np.isnan(modes.damping_ratio)
        self.weight = self.least_noise / self._stack(modes.frequency_error, modes.damping_error)

    def _stack(self, of_frequency: Array, of_damping: Array) -> Array:
        """Data along the first axis: all frequencies, then the dampings that are stated."""
        return np.concatenate([of_frequency, of_damping[self._is_damped]])

    def model_at(self, coordinate: Array) -> tuple[ModelModes, Integers]:
        """Modes of the model, and the index (mode,) of the model's mode paired with each measured one."""
        found = self._solve(values_at(self.parameters, coordinate))
        return found, _pair(found, self._modes)

    def _plant(self, values: Array) -> Plant:
        plant = self._free.plant(with_values(self._device, self.parameters, values))
        own = [v for p, v in zip(self.parameters, values.tolist(), strict=True) if p.part == "sensor"]
        mass_kg = own[0] if own else self._modes.sensor_mass_kg
        sensor = Finger(mass_kg, damping_n_s_per_m=0.0, stiffness_n_per_m=0.0, spread=0.0)
        return plant.with_fingers([self._modes.sensor_m], sensor) if self._modes.sensor_mass_kg else plant

    def _solve(self, values: Array) -> ModelModes:
        plant, count = self._plant(values), len(self._modes) + _BEYOND
        basis = compute_basis(plant, count)
        model = compute_modal_model(basis)
        size, is_still = np.abs(model.pole), np.abs(model.pole.imag) <= _STILL * np.abs(model.pole)
        order = np.lexsort((size, is_still))  # poles that do not oscillate are the last, for want of others
        chosen = order[(is_still | (model.pole.imag > 0))[order] & (size[order] > _STILL)]
        amplitude = model.vector[: len(basis.square_omega), chosen]
        shape = basis.at(self._modes.place_m) @ amplitude
        return ModelModes(plant, model.pole[chosen], basis.shape @ amplitude, shape)

    def _compute(self, coordinate: Array) -> Misfit:
        found, chosen = self.model_at(coordinate)
        pole, field = found.pole[chosen], found.field[:, chosen]
        size, damping = np.abs(pole), -pole.real / np.abs(pole)
        _, C, M = found.plant.dense()
        modal = (field * (2 * pole * (M @ field) + C @ field)).sum(axis=0)
        loaded = self._modes.sensor_mass_kg > 0
        sensor = found.plant.sampler(np.array([self._modes.sensor_m])).sample(field.T)[:, 0] if loaded else 0 * pole
        rates = rates_at(self.parameters, coordinate)
        none, still = 0 * pole, np.zeros((len(pole), len(self._device.actuators)), dtype=np.complex128)
        at = (self._free, found.plant, self.parameters, pole, (field.T, field.T), (sensor**2, none), still)
        by = force_slopes(*at) * rates / modal[:, None]
        of_size = (by / pole[:, None]).real
        of_damping = -by.real / size[:, None] - damping[:, None] * of_size
        damping += _LEAST_DAMPING
        measured = self._modes
        log = self._stack(np.log(size / (2 * np.pi * measured.frequency_hz)), np.log(damping / measured.damping_ratio))
        residual, slope = self.weight * log, self.weight[:, None] * self._stack(of_size, of_damping / damping[:, None])
        return Misfit(residual, slope)


def _pair(found: ModelModes, modes: Modes) -> Integers:
    """Index (mode,) of the model's mode for each measured one, all different, of the least sum of distances."""
    distance = np.log(np.abs(found.pole) / (2 * np.pi * modes.frequency_hz[:, None])) ** 2
    distance[:, found.pole.imag <= _STILL * np.abs(found.pole)] += _OVERDAMPED
    chosen: Integers = linear_sum_assignment(distance + 1 - _assurance(found, modes))[1]
    return chosen


def _assurance(found: ModelModes, modes: Modes) -> Array:
    """Modal assurance criterion (measured mode, model's mode); 1 where a mode has less than two places."""
    out = np.ones((len(modes), len(found.pole)))
    for row, shape in zip(out, modes.shape, strict=True):
        known = np.isfinite(shape)
        if known.sum() >= 2:
            a, b = shape[known], found.shape[known]
            row[:] = np.abs(a.conj() @ b) ** 2 / np.maximum(
                (np.abs(a) ** 2).sum() * (np.abs(b) ** 2).sum(axis=0), 1e-300
            )
    return out


@dataclass(frozen=True)
class ModalCalibration(FittedDevice):
    """A device fitted to modes.

    number (mode,): of the fitted device's mode that each measured one is paired with, from 1. fitted_hz,
    fitted_damping (mode,): of that mode; assurance (mode,): its modal assurance criterion, 1 without a shape.
    """

    modes: Modes
    number: Integers
    fitted_hz: Array
    fitted_damping: Array
    assurance: Array

    @property
    def off(self) -> Array:
        """Shape (2, mode): measured over fitted frequency and damping ratio, less one; NaN where none is stated."""
        modes = self.modes
        return np.stack([modes.frequency_hz / self.fitted_hz, modes.damping_ratio / self.fitted_damping]) - 1


def modal_names(device: Device, modes: Modes) -> tuple[str, ...]:
    """The usual parameters of a fit that modes can tell: no full scale, and dampings only where the modes have some."""
    has_damping = not np.isnan(modes.damping_ratio).all()
    left_out = ("full_scale", *(() if has_damping else ("damping",)))
    return tuple(name for name in default_names(device) if not name.endswith(left_out))


def calibrate_modes(
    device: Device,
    modes: Modes,
    parameters: Sequence[str] | None = None,
    *,
    bounds: Mapping[str, Bounds] | None = None,
    starts: int = STARTS,
    seed: int = 0,
) -> ModalCalibration:
    """Fit `parameters` (default: `modal_names`) of `device` to modes; `bounds` are SI.

    Raises ParameterError for names and bounds, MeasurementError for a parameter that no mode depends on.
    """
    names = modal_names(device, modes) if parameters is None else tuple(parameters)
    chosen = find_parameters(device, names, bounds or {}, modes.sensor_mass_kg)
    if len(modes) > (most := assemble(device).size // 2):
        raise MeasurementError(f"there are {len(modes)} modes; the model has {most} at the most: leave the highest out")
    with threadpool_limits(1, "blas"):  # unlimited BLAS is 100 times slower on a busy machine
        misfit = ModesMisfit(device, modes, chosen)
        problem = pose(misfit)
        for parameter, column in zip(chosen, misfit.at(problem.start).log_slope.T, strict=True):
            if not column.any():
                raise MeasurementError(f"{parameter.name}: not identifiable: no mode changes with it; leave it out")
        found = fit(problem, starts, seed)
        fitted = conclude(device, found)
        model, pair = misfit.model_at(found.coordinate)
    pole = model.pole[pair]
    return ModalCalibration(
        **vars(fitted),
        modes=modes,
        number=pair + 1,
        fitted_hz=np.abs(pole) / (2 * np.pi),
        fitted_damping=-pole.real / np.abs(pole),
        assurance=_assurance(model, modes)[np.arange(len(pair)), pair],
    )


def modal_report(calibration: ModalCalibration) -> dict[str, Any]:
    """All results of the fit in SI, ready for JSON, as `calibration_report` gives them for accelerations."""
    modes, off = calibration.modes, calibration.off
    rows = zip(
        calibration.number.tolist(),
        modes.frequency_hz.tolist(),
        calibration.fitted_hz.tolist(),
        to_plain(modes.damping_ratio),
        calibration.fitted_damping.tolist(),
        calibration.assurance.tolist(),
        strict=True,
    )
    keys = ("mode", "frequency_hz", "fitted_hz", "damping_ratio", "fitted_damping_ratio", "modal_assurance")
    report = report_of_fit(calibration)
    report["open"].append({"text": _RATIOS, "singular_value": 0.0, "parts": {"actuator.full_scale": 1.0}})
    return report | {
        "simulated": modes.is_simulated,
        "kind": "natural frequencies and damping ratios",
        "readings": len(modes),
        "median_misfit": float(np.median(np.abs(off[0]))),
        "modes": [dict(zip(keys, row, strict=True)) for row in rows],
        "wrong_readings": [],
        "adequacy": {"doubt": _doubt(calibration)},
    }


def _doubt(calibration: ModalCalibration) -> str:
    """A sentence with the remedy where modes are off by more than their errors, or a shape belongs to no model mode."""
    modes, off = calibration.modes, calibration.off
    errors = np.nan_to_num(off / np.stack([modes.frequency_error, modes.damping_error]))
    values = len(modes) + int((~np.isnan(modes.damping_ratio)).sum())
    chance = float(chdtrc(max(values - len(calibration.estimates), 1), (errors**2).sum()))
    matters = np.abs(off) >= np.array([[SMALLEST_MISFIT], [DAMPING_ERROR]])
    worst = int(np.argmin(calibration.assurance))
    check = "check the pairing, the device file's lengths, and whether fingers or other masses were on the surface"
    if calibration.assurance[worst] < _LEAST_ASSURANCE:
        return (
            f"the shape at {modes.frequency_hz[worst]:.6g} Hz agrees with no mode of the model (modal assurance "
            f"criterion {calibration.assurance[worst]:.2g}): {check}"
        )
    if chance >= UNLIKELY or not matters.any():
        return ""
    kind, worst = (int(i) for i in np.unravel_index(np.argmax(np.abs(errors) * matters), errors.shape))
    return (
        f"the {('frequency', 'damping ratio')[kind]} at {modes.frequency_hz[worst]:.6g} Hz is "
        f"{100 * off[kind, worst]:+.2g} % off the fitted mode {calibration.number[worst]}, "
        f"{abs(errors[kind, worst]):.2g} times its error: {check}; --also bar.density or actuator.mass may explain it"
    )
