"""Damped modes of the plant: poles and mode shapes of the state space, with the coupling by dampers kept."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from engine.device import Finger
from precompute.model.assembly import Plant, dense

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

MODES = 40
"""Undamped modes kept: with them the steady state equals the frequency response within 0.1 % up to 1 kHz."""


@dataclass(frozen=True)
class Basis:
    """Undamped modes of the untouched bar, mass-normalised: `shape` (degree of freedom, mode) spans every motion."""

    plant: Plant
    shape: Array
    square_omega: Array
    damping: Array

    def lowest(self, modes: int) -> "Basis":
        """The basis of the lowest `modes` modes alone."""
        kept = slice(modes)
        shape, damping = np.ascontiguousarray(self.shape[:, kept]), np.ascontiguousarray(self.damping[kept, kept])
        return Basis(self.plant, shape, self.square_omega[kept], damping)

    def at(self, position_m: Array) -> Array:
        """Mode shapes at positions: (point, mode)."""
        sampler = self.plant.sampler(position_m)
        columns = 2 * sampler.element[:, None] + np.arange(4)
        values: Array = np.einsum("pkm,pk->pm", self.shape[columns], sampler.weight)
        return values


@dataclass(frozen=True)
class ModalModel:
    """State (q, q') = vector z with z' = pole z + spring u + damper u', u (actuator,) as fractions of full scale.

    pole (state,); vector (2 mode, state) and its inverse; spring, damper (state, actuator): what a base displacement
    and its rate put in; push (mode, 2, actuator): the same as mode accelerations.
    """

    basis: Basis
    pole: Complex
    vector: Complex
    inverse: Complex
    spring: Complex
    damper: Complex
    push: Array


def compute_basis(plant: Plant, modes: int = MODES) -> Basis:
    """The lowest `modes` undamped modes of the plant."""
    count = min(modes, plant.size)
    square, shape = scipy.linalg.eigh(dense(plant.K), dense(plant.M), subset_by_index=(0, count - 1))
    # Not below 0, where rounding puts the free turning about a single actuator.
    return Basis(plant, shape, np.maximum(square, 0.0), shape.T @ dense(plant.C) @ shape)


def compute_modal_model(basis: Basis, fingers: Sequence[tuple[float, Finger]] = ()) -> ModalModel:
    """Damped modes with fingers (position in metres, finger) added to the untouched bar's basis."""
    count = len(basis.square_omega)
    M, K, C = np.eye(count), np.diag(basis.square_omega), basis.damping.copy()
    rows = basis.at(np.array([position_m for position_m, _ in fingers]))
    for row, (_, finger) in zip(rows, fingers, strict=True):
        outer = np.outer(row, row)
        M += finger.mass_kg * outer
        K += finger.stiffness_n_per_m * outer
        C += finger.damping_n_s_per_m * outer
    system = np.block([[np.zeros((count, count)), np.eye(count)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    pole, vector = np.linalg.eig(system)
    pole = np.minimum(pole.real, 0.0) + 1j * pole.imag  # passive: growth is rounding
    inverse = np.linalg.inv(vector)
    push = np.asarray(np.linalg.solve(M, _forces(basis).reshape(count, -1)), dtype=np.float64).reshape(count, 2, -1)
    spring, damper = (np.asarray(inverse[:, count:] @ push[:, i], dtype=np.complex128) for i in (0, 1))
    return ModalModel(basis, pole, vector, inverse, spring, damper, push)


def _forces(basis: Basis) -> Array:
    """Modal force per unit base displacement and per unit rate: (mode, 2, actuator)."""
    actuators = basis.plant.device.actuators
    drive = basis.shape[basis.plant.actuator_dof].T
    spring = np.array([a.stiffness_n_per_m * a.full_scale_m for a in actuators])
    damper = np.array([a.damping_n_s_per_m * a.full_scale_m for a in actuators])
    return np.stack([drive * spring, drive * damper], axis=1)
