"""Exact discrete-time model of the bar with fingers: commanded displacements over time to accelerations."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from base.arrays import Array, Complex
from engine.device import Finger
from precompute.model.modal import Basis, ModalModel, compute_modal_model
from precompute.model.transfers import DelayFilter, TransferFilter, decaying_sums, step_integrals

_CHUNK = 8192  # samples: bounds memory, 2 MB for 20 modes and complex values
_BLOCK = 32  # samples of one matrix product; 64 are faster for one point (1.5), slower for the modes of the page (2)


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
    model: ModalModel | None = None
    """The damped modes at the beginning; None: those without fingers. `take_model` changes them."""
    _model: ModalModel = field(init=False)
    _state: Array = field(init=False)
    _last: Array = field(init=False)
    _filters: list[tuple[int, DelayFilter | TransferFilter]] = field(init=False)
    _blocks: "_Blocks | None" = field(init=False)

    def __post_init__(self) -> None:
        self.rest()
        self.look_at(self.position_m)
        self.take_model(self.model or compute_modal_model(self.basis, ()))

    def look_at(self, position_m: Array | Complex) -> None:
        """The points whose acceleration `run` gives from now on."""
        self.position_m = position_m
        self._shape = self.basis.at(position_m)
        self._blocks = None

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
        self._blocks = None

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
        for chunk in _chunks(self._moved(displacement)):
            z, acceleration_of_chunk = self._advance(chunk)
            acceleration.append(acceleration_of_chunk)
            velocity = _real_product(self._vector[modes:], z)
            product += velocity @ velocity.T
        return np.concatenate(acceleration), _zone_energy(self.basis, product) / self.sample_rate_hz

    def accelerate(self, displacement: Array) -> Array:
        """The acceleration of `run` alone, by blocks of samples, at a quarter of the time for one point."""
        moved = self._moved(displacement)
        whole = len(moved) - len(moved) % _BLOCK
        found = [self._accelerate_blocks(chunk) for chunk in _chunks(moved[:whole])]
        if whole < len(moved):
            found.append(self._advance(moved[whole:])[1])
        return np.concatenate([np.empty((0, len(self.position_m))), *found])

    def _moved(self, displacement: Array) -> Array:
        """What the bases do of what is commanded, through the delay and the transfer function of each actuator."""
        if self._filters and len(displacement):
            displacement = displacement.copy()
            for index, each in self._filters:
                displacement[:, index] = each.run(displacement[:, index])
        return displacement

    def _forcing(self) -> tuple[Complex, Complex, Complex]:
        """Per kept mode its growth over one step, and what (state, actuator) a base adds before and after the step.

        Exact for u linear within a step: z' = s z + spring (u0 + rate t) + damper rate.
        """
        model, kept, step_s = self._model, self._kept, 1 / self.sample_rate_hz
        pole, spring, damper = model.pole[kept], model.spring[kept], model.damper[kept]
        phi_1, phi_2 = (phi[:, None] for phi in step_integrals(pole, step_s))
        after = (phi_1 * damper + phi_2 * spring) / step_s
        return np.exp(pole * step_s), phi_1 * spring - after, after

    def _pushed(self) -> tuple[Array, Array]:
        """Acceleration (point, actuator) that a base gives at once: of its displacement, and of its step."""
        return self._shape @ self._model.push[:, 0], self._shape @ self._model.push[:, 1] * self.sample_rate_hz

    def _seen(self) -> Complex:
        """Acceleration (point, state) of the kept states."""
        return self._shape @ (self._vector[len(self.basis.square_omega) :] * self._model.pole[self._kept])

    def _advance(self, moved: Array) -> tuple[Complex, Array]:
        """Kept states (state, time) and accelerations (time, point) over one chunk of the bases' displacements."""
        grow, before, after = self._forcing()
        forced = before @ np.vstack([self._last, moved[:-1]]).T + after @ moved.T
        state = self._model.inverse[self._kept] @ self._state
        z = np.empty_like(forced)
        for k in range(len(grow)):
            z[k] = decaying_sums(grow[k], forced[k], state[k])
        of_place, of_step = self._pushed()
        acceleration = _real_product(self._seen(), z) + of_place @ moved.T
        acceleration += of_step @ np.diff(moved, axis=0, prepend=self._last[None]).T
        self._state, self._last = (self._vector @ z[:, -1]).real, moved[-1]
        return z, acceleration.T

    def _accelerate_blocks(self, moved: Array) -> Array:
        """Accelerations (time, point) over whole blocks."""
        if self._blocks is None or self._blocks.rate_hz != self.sample_rate_hz:
            self._blocks = _Blocks.of(self.sample_rate_hz, self._forcing(), self._seen(), *self._pushed())
        blocks, padded = self._blocks, np.vstack([self._last, moved])
        windows = sliding_window_view(padded, _BLOCK + 1, axis=0)[::_BLOCK].transpose(0, 2, 1)
        given = windows.reshape(len(windows), -1).T
        state = self._model.inverse[self._kept] @ self._state
        forced = blocks.forced @ given
        z = np.empty((len(state), forced.shape[1] + 1), dtype=np.complex128)
        z[:, 0] = state
        for k in range(len(state)):
            z[k, 1:] = decaying_sums(blocks.grow[k], forced[k], state[k])
        self._state, self._last = (self._vector @ z[:, -1]).real, moved[-1]
        acceleration = _real_product(blocks.free, z[:, :-1]) + blocks.answer @ given
        return acceleration.reshape(_BLOCK, -1, acceleration.shape[1]).transpose(2, 0, 1).reshape(len(moved), -1)


@dataclass(frozen=True)
class _Blocks:
    """One block of samples as matrices. `given` are the displacements of the sample before the block and of its own.

    grow (state,) and forced (state, given): the states at its end from those before it, and from what is given;
    free (sample point, state) and answer (sample point, given): its accelerations from the same.
    """

    rate_hz: float
    grow: Complex
    forced: Complex
    free: Complex
    answer: Array

    @classmethod
    def of(
        cls,
        rate_hz: float,
        forcing: tuple[Complex, Complex, Complex],
        seen: Complex,
        of_place: Array,
        of_step: Array,
    ) -> Self:
        """The block of a plant, from its `_forcing`, `_seen` and `_pushed`."""
        grow, before, after = forcing
        powers = grow ** np.arange(_BLOCK + 1)[:, None]  # (step, state)
        both = (
            grow[:, None] * after + before
        )  # a displacement acts at the end of one step and the beginning of the next
        inner = powers[_BLOCK - 2 :: -1, :, None] * both
        forced = np.concatenate([powers[_BLOCK - 1, None, :, None] * before, inner, after[None]])
        later = (seen @ (powers[: _BLOCK - 1, :, None] * both)).real  # (step, point, actuator)
        later[0] -= of_step
        first = (seen @ (powers[:_BLOCK, :, None] * before)).real
        first[0] -= of_step
        answer = np.zeros((_BLOCK, len(seen), _BLOCK + 1, before.shape[1]))
        answer[:, :, 0] = first
        for k in range(_BLOCK):
            answer[k, :, k + 1] = (seen @ after).real + of_place + of_step
            answer[k + 1 :, :, k + 1] = later[: _BLOCK - 1 - k]
        free = (powers[1:, None] * seen).reshape(-1, len(grow))
        joined = forced.transpose(1, 0, 2).reshape(len(grow), -1)
        return cls(rate_hz, powers[_BLOCK], joined, free, answer.reshape(len(free), (_BLOCK + 1) * before.shape[1]))


def _chunks(displacement: Array) -> Iterator[Array]:
    return (displacement[start : start + _CHUNK] for start in range(0, len(displacement), _CHUNK))


def _real_product(matrix: Complex, values: Complex) -> Array:
    """Real part of matrix @ values, at half the cost."""
    return matrix.real @ values.real - matrix.imag @ values.imag


def _zone_energy(basis: Basis, product: Array) -> Array:
    """Sum over each zone of q'^T (integral of N N^T) q', from the summed products q' q'^T (mode, mode)."""
    between = basis.plant.gram(np.ascontiguousarray(basis.shape.T[None], dtype=np.complex128))[0, :-1].real
    return np.einsum("zmn,mn->z", between, product)
