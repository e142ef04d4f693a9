"""Exact discrete-time model of the bar with fingers: commanded displacements over time to accelerations."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from base.arrays import Array, Complex
from engine.device import Finger
from precompute.model.modal import Basis, ModalModel, compute_modal_model
from precompute.model.transfers import DelayFilter, TransferFilter, decaying_sums, step_integrals

_CHUNK = 8192  # samples: bounds memory, 2 MB for 20 modes and complex values


@dataclass
class TransientPlant:
    """The bar in time. Base displacements run in straight lines between samples; everything else is exact.

    A base follows its command through the delay and the transfer function of the actuator, where the device file has
    them.

    Feed it stretch after stretch with `run`; fingers may change between stretches (`touch`): deflection and velocity
    of the bar carry over. At 48 kHz the straight lines cost 1.3e-4 of a 300 Hz tone.
    """

    basis: Basis
    position_m: Array | Complex
    sample_rate_hz: float
    _model: ModalModel = field(init=False)
    _state: Array = field(init=False)
    _last: Array = field(init=False)
    _filters: list[tuple[int, DelayFilter | TransferFilter]] = field(init=False)

    def __post_init__(self) -> None:
        self.rest()
        self.look_at(self.position_m)
        self.touch(())

    def look_at(self, position_m: Array | Complex) -> None:
        """The points whose acceleration `run` gives from now on."""
        self.position_m = position_m
        self._shape = self.basis.at(position_m)

    def touch(self, fingers: Sequence[tuple[complex, Finger]]) -> None:
        """The fingers on the bar from now on: (position in metres, finger)."""
        self.take_model(compute_modal_model(self.basis, fingers))

    def take_model(self, model: ModalModel) -> None:
        """The damped modes from now on: those of the basis under some fingers."""
        self._model = model
        # Poles come in conjugate pairs: one of each is enough, counted twice.
        self._kept = np.flatnonzero(self._model.pole.imag >= 0)
        weight = np.where(self._model.pole[self._kept].imag > 0, 2.0, 1.0)
        self._vector = self._model.vector[:, self._kept] * weight

    def rest(self) -> None:
        """Put the bar at rest, with its fingers where they are."""
        actuators = self.basis.plant.device.actuators
        self._state, self._last = np.zeros(2 * len(self.basis.square_omega)), np.zeros(len(actuators))
        self._filters = []
        for index, actuator in enumerate(actuators):
            if actuator.delay_s:
                self._filters.append((index, DelayFilter(actuator.delay_s, self.sample_rate_hz)))
            if actuator.transfer is not None:
                self._filters.append((index, TransferFilter(actuator.transfer, self.sample_rate_hz)))

    def run(self, displacement: Array) -> tuple[Array, Array]:
        """Acceleration (time, point) in m/s^2 and zone energy (zone,) summed over the stretch.

        displacement (time, actuator): what is commanded, as fractions of full scale. The zone energies are the time
        integral of the velocity squared over each zone, m^3/s: their ratios are localized factors, paper eq. (10).
        """
        modes = len(self.basis.square_omega)
        acceleration, product = [np.empty((0, len(self.position_m)))], np.zeros((modes, modes))
        for chunk in _chunks(displacement):
            z, acceleration_of_chunk = self._advance(chunk)
            acceleration.append(acceleration_of_chunk)
            velocity = _real_product(self._vector[modes:], z)
            product += velocity @ velocity.T
        return np.concatenate(acceleration), _zone_energy(self.basis, product) / self.sample_rate_hz

    def accelerate(self, displacement: Array) -> Array:
        """The acceleration of `run` alone; the energies take most of the time of a run."""
        none = np.empty((0, len(self.position_m)))
        return np.concatenate([none, *(self._advance(chunk)[1] for chunk in _chunks(displacement))])

    def _advance(self, displacement: Array) -> tuple[Complex, Array]:
        """Kept states (state, time) and accelerations (time, point) over one chunk."""
        model, kept, step_s = self._model, self._kept, 1 / self.sample_rate_hz
        modes = len(self.basis.square_omega)
        if self._filters:
            displacement = displacement.copy()
            for index, each in self._filters:
                displacement[:, index] = each.run(displacement[:, index])
        before = np.vstack([self._last, displacement[:-1]])
        rate = (displacement - before) / step_s
        pole, spring, damper = model.pole[kept], model.spring[kept], model.damper[kept]
        # Exact for u linear within a step: z' = s z + spring (u0 + rate t) + damper rate.
        grow = np.exp(pole * step_s)
        phi_1, phi_2 = step_integrals(pole, step_s)
        forced = (phi_1[:, None] * spring) @ before.T + (phi_1[:, None] * damper + phi_2[:, None] * spring) @ rate.T
        state = model.inverse[kept] @ self._state
        z = np.empty_like(forced)
        for k in range(len(kept)):
            z[k] = decaying_sums(grow[k], forced[k], state[k])
        self._state, self._last = (self._vector @ z[:, -1]).real, displacement[-1]
        acceleration = _real_product(self._shape @ (self._vector[modes:] * pole), z)
        acceleration += (self._shape @ model.push[:, 0]) @ displacement.T + (self._shape @ model.push[:, 1]) @ rate.T
        return z, acceleration.T


def _chunks(displacement: Array) -> Iterator[Array]:
    return (displacement[start : start + _CHUNK] for start in range(0, len(displacement), _CHUNK))


def _real_product(matrix: Complex, values: Complex) -> Array:
    """Real part of matrix @ values, at half the cost."""
    return matrix.real @ values.real - matrix.imag @ values.imag


def _zone_energy(basis: Basis, product: Array) -> Array:
    """Sum over each zone of q'^T (integral of N N^T) q', from the summed products q' q'^T (mode, mode)."""
    between = basis.plant.gram(np.ascontiguousarray(basis.shape.T[None], dtype=np.complex128))[0, :-1].real
    return np.einsum("zmn,mn->z", between, product)
