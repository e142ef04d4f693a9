"""Samples of a sensor that stays, with the drive beside them, to the drift of the surface and the load of each finger.

Theory of operation
-------------------
What is not known are logarithms of factors: of Young's modulus, as temperature changes it; of the sensor's gain; of the
density; of all damping; of the stiffness and the mass of every actuator; and for every contact of the standard finger's
impedance. They are estimated window after window by regularised least squares (an iterated extended Kalman filter):
what is known after a window is the prior of the next. The first priors are the device's [spread].

1. The *drift* is that of Young's modulus over the density, whose root natural frequencies follow. A light sensor tells
   it far better than either: a surface whose stiffnesses and masses are all 1 % greater moves alike.
2. The forced part of a window is computed in time from the drive that was sampled beside the acceleration, so tones,
   clicks and their transients are treated alike, and neither a clock nor a latency enters.
3. What the surface did before the window is not known. Free decays of all modes below half the sample rate, gravity and
   a slope are projected out, so that a window may begin at any time, even just after a finger has landed.
4. Errors of the model count as noise of `_MODEL_ERROR` of the signal. A residual of more than `_REFUSED_AT` times noise
   and model error refuses the window, as does a value too far from its prior (`_CREDIBLE`). Under the same fingers the
   model errs the same way again, so the k-th window since they came counts for 1/k^2 of the first.

A contact that lifts is forgotten.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from scipy.signal import resample_poly

from base.arrays import Array, Complex
from engine.device import Device, Finger
from precompute.model.assembly import free_surface
from precompute.model.modal import ModalModel, compute_basis, compute_modal_model
from precompute.model.transient import TransientPlant

MOST_DRIFT = 0.03
"""Greatest drift that is believed: an ESTIMATE. Glass and metals lose 0.01 to 0.05 % of E per kelvin."""
_DRIFT_AT_FIRST, _DRIFT_PER_ROOT_S = 0.01, 1.3e-4  # beside the spread; then 0.1 % a minute (ESTIMATES)
_GAIN_AT_FIRST = 0.05  # sensitivity of the sensor and full scale of the board together (ESTIMATE)
_DAMPING_AT_FIRST = 0.2  # of surface and actuators, where the spread does not ask for more (ESTIMATE)
_FINGER_PER_WINDOW = 0.03  # how far a finger's impedance wanders from one window to the next (ESTIMATE)
_WITHIN_95, _CREDIBLE = 1.96, 4.0  # standard deviations
_LEAST = 1e-4  # standard deviation of what the spread says to be known
_MODEL_ERROR, _REFUSED_AT = 0.02, 3.0
_MOST_ALIKE = 10  # windows under the same fingers, after which all count as little (ESTIMATE)
_DIFFERENCES = 8  # of samples: 300 Hz of 3200 samples a second are a hundredth of white noise of the same size in them
_FINE_HZ = 25_600.0  # of straight lines in the drive: 0.005 dB of 300 Hz, as in the simulated sensor
_SETTLES_S = 0.025  # of the drive before the window, for filters of actuators and of the interpolation
_JACOBIANS, _DAMPINGS, _STARTS = 8, (0.0, 0.01, 0.1, 1.0), 24
_STEP, _ENOUGH = 1e-4, 0.05  # of unknowns; of the sum of squares, whose expectation is the number of samples
_MODULUS, _GAIN, _DENSITY, _DAMPING, _ACTUATORS = range(5)
"""Places among the unknowns: from the last on stiffness and mass of each actuator, then the fingers."""
Contacts = Mapping[int, complex]  # points of the fingers, by contact


@dataclass(frozen=True)
class Estimate:
    """What is known after a window.

    drift: factor of Young's modulus over the density, less 1, with its standard error; device: what explains the
    samples, springs and masses of the actuators included. loads: for every contact the natural logarithm of its
    impedance over the standard finger's, with its standard error. misfit: root mean square of the residual over that of
    the samples. refusal: why the window was not used, and everything is as before; "": it was used.
    """

    drift: float
    drift_error: float
    device: Device
    loads: Mapping[int, tuple[float, float]]
    misfit: float
    refusal: str


class LoadEstimator:
    """Estimates from one sensor of `mass_kg` at `sensor_m`; `rate_hz` is that of its samples, and may be corrected.

    Raises DeviceError for a bar with inertial actuators.
    """

    def __init__(self, device: Device, sensor_m: complex, mass_kg: float, rate_hz: float) -> None:
        self.rate_hz, self._device, self._free = rate_hz, device, free_surface(device)
        self._modes = len(compute_basis(self._free.plant(device)).square_omega)
        self._sensor_m, self._fine = sensor_m, math.ceil(_FINE_HZ / rate_hz)
        self._sensor = (sensor_m, replace(device.finger, mass_kg=mass_kg, damping_n_s_per_m=0.0, stiffness_n_per_m=0.0))
        stiffness, mass = device.spread.stiffness, device.spread.mass
        damping = max(device.spread.damping, _DAMPING_AT_FIRST)
        of_surface = [math.hypot(_DRIFT_AT_FIRST, stiffness), _GAIN_AT_FIRST, mass, damping]
        self._first = np.maximum([*of_surface, *[stiffness, mass] * len(device.actuators)], _LEAST)
        self._finger_error = max(math.log(device.finger.spread) / _WITHIN_95, _LEAST)
        self._own = len(self._first)
        self._contacts: tuple[int, ...] = ()
        self._alike = 0  # windows with the same fingers
        self._mean, self._covariance = np.zeros(self._own), np.diag(self._first**2)
        self.margin = math.ceil(_SETTLES_S * rate_hz)
        """Samples before a window of which only the drive is read."""

    def take_window(self, samples: Array, contacts: Contacts, elapsed_s: float) -> Estimate:
        """The estimate after one more window, `elapsed_s` after the one before.

        samples (sample, 1 + actuator): acceleration in m/s^2 and displacements as fractions of full scale; the first
        `margin` of them lie before the window. contacts: where fingers lay in all of it.
        """
        self._begin(contacts, elapsed_s)
        fingers = [contacts[contact] for contact in self._contacts]
        drive, measured = resample_poly(samples[:, 1:], self._fine, 1, axis=0), samples[self.margin :, 0]
        noise = np.std(np.diff(measured, _DIFFERENCES)) / math.sqrt(math.comb(2 * _DIFFERENCES, _DIFFERENCES))
        size = float(np.std(measured))
        once = math.hypot(noise, _MODEL_ERROR * size)
        scale = math.hypot(noise, _MODEL_ERROR * size * self._alike)
        root, prior = np.linalg.cholesky(np.linalg.inv(self._covariance)).T, self._mean

        def misfit_of(unknown: Array) -> Array:
            left = (measured - self._forced(self._model(unknown, fingers), unknown, drive)) / scale
            return np.append(left - free @ (free.T @ left), root @ (unknown - prior))

        mean = prior
        for number in range(_JACOBIANS):
            # The decays are fitted once an iteration: fitted for every trial, they would follow the noise.
            free = _free_decays(self._model(mean, fingers).pole, self.rate_hz, len(measured))
            tried = [(each, misfit_of(each)) for each in (mean + self._starts() if number == 0 else [mean])]
            mean, misfit = min(tried, key=lambda found: float(found[1] @ found[1]))
            moved, cost = mean + _STEP * np.eye(len(mean)), misfit @ misfit
            jacobian = np.column_stack([(misfit_of(each) - misfit) / _STEP for each in moved])
            square = jacobian.T @ jacobian
            for damping in _DAMPINGS:
                step = -np.linalg.solve(square + damping * np.diag(square.diagonal()), jacobian.T @ misfit)
                trial = misfit_of(mean + step)
                if trial @ trial < cost:
                    mean, misfit = mean + step, trial
                    break
            if cost - misfit @ misfit < _ENOUGH:
                break
        rms = float(np.sqrt(np.mean(misfit[: len(measured)] ** 2)))
        refusal = self._refusal(mean, rms * scale / once)
        if not refusal:
            self._mean, self._covariance = mean, np.linalg.inv(square)
        return self._estimate(rms * scale / size, refusal)

    def _begin(self, contacts: Contacts, elapsed_s: float) -> None:
        """Forget contacts that lifted, give new ones the prior, and let time widen what is known."""
        kept = [contact for contact in self._contacts if contact in contacts]
        come = [contact for contact in contacts if contact not in self._contacts]
        self._alike = 1 if come or len(kept) < len(self._contacts) else min(self._alike + 1, _MOST_ALIKE)
        at = [*range(self._own), *(self._own + self._contacts.index(contact) for contact in kept)]
        covariance = self._covariance[np.ix_(at, at)] + np.diag([0.0] * self._own + [_FINGER_PER_WINDOW**2] * len(kept))
        covariance[_MODULUS, _MODULUS] += _DRIFT_PER_ROOT_S**2 * elapsed_s
        self._contacts, self._mean = (*kept, *come), np.append(self._mean[at], np.zeros(len(come)))
        self._covariance = scipy.linalg.block_diag(covariance, np.eye(len(come)) * self._finger_error**2)

    def _starts(self) -> Array:
        """Changes (start, unknown) of what is known, from which the search begins: none, and others of new contacts."""
        is_new = self._covariance.diagonal() == self._finger_error**2
        varied = np.random.default_rng(0).uniform(-2, 2, (_STARTS if is_new.any() else 0, len(is_new)))
        return np.concatenate([np.zeros((1, len(is_new))), self._finger_error * varied * is_new])

    def _refusal(self, mean: Array, rms: float) -> str:
        """Why an outcome is not believed; "": it is."""
        drift, own = math.expm1(mean[_MODULUS] - mean[_DENSITY]), self._own
        checks = {
            f"the residual is {rms:.1f} times what noise and model explain": rms > _REFUSED_AT,
            f"a drift of {100 * drift:+.1f} % is beyond {100 * MOST_DRIFT:g} %": abs(drift) > MOST_DRIFT,
            "gain or actuators are not credible": (abs(mean[_GAIN:own]) > _CREDIBLE * self._first[_GAIN:]).any(),
            "the load of a finger is not credible": (abs(mean[own:]) > _CREDIBLE * self._finger_error).any(),
        }
        return next((text for text, is_wrong in checks.items() if is_wrong), "")

    def _estimate(self, misfit: float, refusal: str) -> Estimate:
        mean, covariance, both = self._mean, self._covariance, [_MODULUS, _DENSITY]
        drift, error = math.expm1(mean[_MODULUS] - mean[_DENSITY]), np.sqrt(covariance.diagonal())
        of_fingers = zip(mean[self._own :].tolist(), error[self._own :].tolist(), strict=True)
        loads = dict(zip(self._contacts, of_fingers, strict=True))
        drift_error = (1 + drift) * math.sqrt((covariance[np.ix_(both, both)] * [[1, -1], [-1, 1]]).sum())
        return Estimate(drift, drift_error, self._device_of(mean), loads, misfit, refusal)

    def _device_of(self, unknown: Array) -> Device:
        """The device with these values."""
        device, factors = self._device, np.exp(unknown).tolist()
        surface = replace(
            device.surface,
            youngs_modulus_pa=device.surface.youngs_modulus_pa * factors[_MODULUS],
            density_kg_per_m3=device.surface.density_kg_per_m3 * factors[_DENSITY],
            mass_damping_per_s=device.surface.mass_damping_per_s * factors[_DAMPING],
            stiffness_damping_s=device.surface.stiffness_damping_s * factors[_DAMPING],
        )
        of_actuators = zip(device.actuators, factors[_ACTUATORS::2], factors[_ACTUATORS + 1 :: 2], strict=False)
        actuators = (
            replace(each.scaled(stiffness, mass), damping_n_s_per_m=each.damping_n_s_per_m * factors[_DAMPING])
            for each, stiffness, mass in of_actuators
        )
        return replace(device, surface=surface, actuators=tuple(actuators))

    def _model(self, unknown: Array, fingers: Sequence[complex]) -> ModalModel:
        """The surface with sensor and fingers."""
        factors = np.exp(unknown[self._own :]).tolist()
        loads = [(at_m, scaled_finger(self._device.finger, each)) for at_m, each in zip(fingers, factors, strict=True)]
        basis = compute_basis(self._free.plant(self._device_of(unknown)), self._modes)
        return compute_modal_model(basis, [self._sensor, *loads])

    def _forced(self, model: ModalModel, unknown: Array, drive: Array) -> Array:
        """What the sensor reads in the window (sample,) of a drive that begins at rest with its margin."""
        plant = TransientPlant(model.basis, np.array([self._sensor_m]), self.rate_hz * self._fine, model)
        return math.exp(unknown[_GAIN]) * plant.accelerate(drive)[:: self._fine][self.margin :, 0]


def scaled_finger(finger: Finger, factor: float) -> Finger:
    """The finger with `factor` times its impedance."""
    mass_kg, damping, stiffness = finger.mass_kg * factor, finger.damping_n_s_per_m, finger.stiffness_n_per_m
    return replace(finger, mass_kg=mass_kg, damping_n_s_per_m=damping * factor, stiffness_n_per_m=stiffness * factor)


def _free_decays(pole: Complex, rate_hz: float, count: int) -> Array:
    """Orthonormal columns (sample, column): free decays of the poles below half the rate, a constant and a slope."""
    kept, row = pole[(pole.imag >= 0) & (pole.imag < math.pi * rate_hz)], np.arange(count)
    decay = np.exp(np.outer(row / rate_hz, kept))
    columns = np.column_stack([decay.real, decay.imag[:, kept.imag > 0], np.ones(count), row / count])
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, size > 1e-6 * size[0]], dtype=np.float64)
