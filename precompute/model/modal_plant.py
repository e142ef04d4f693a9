"""A plant of modes: functions that span the motion of a surface, with actuators, as undamped modes of both together.

The functions are Ritz's on a plate and the finite elements on a bar. Actuators enter as springs, dampers and masses at
points, exactly as in `precompute.model.assembly`. The moving mass of an inertial actuator is one degree of freedom
more: its spring, its damper and its force act between the surface and that mass.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, Self

import numpy as np
import scipy.linalg
from threadpoolctl import threadpool_limits

from base.arrays import Array, Complex, Points
from engine.device import Device, Finger
from precompute.model.plant import KnownDrive, Plant, Sampler, moved_masses

_MOST_MODES = 150  # those above, at about 10 kHz on a tablet, would be as stiff as 3 MN/m at a point
_HELD = 100.0  # stiffness of the springs at measured points, in that of the highest mode


class Functions(Protocol):
    """Functions over a surface that span its motion."""

    def at(self, points_m: Points) -> Array:
        """The functions at points (point,): (point, function)."""

    def mean_products(self, start_m: complex, stop_m: complex) -> Array:
        """Integral of f_k f_l over a part of the surface: (function, function)."""

    @property
    def bending(self) -> Array:
        """Strain energy of bending (function, function), but for a factor."""

    @property
    def resolution(self) -> dict[str, int | float]:
        """Attributes of a table that say how finely the surface is resolved."""


class ModeSampler(Sampler):
    """A sampler whose every point sees all degrees of freedom: one product, without a copy of the field a point."""

    def sample(self, field: Complex) -> Complex:
        """Shape (..., point) from a field (..., degree of freedom)."""
        return np.asarray(field @ self.weight.T)

    def shapes(self, shape: Array) -> Array:
        """Shape (point, mode) from mode shapes (degree of freedom, mode)."""
        return np.asarray(self.weight @ shape)


@dataclass(frozen=True)
class ModalPlant(Plant):
    """A surface on its actuators; its degrees of freedom are the undamped modes of both together, mass-normalised.

    shape (function, mode); moved (inertial actuator, mode): the motion of the moving masses; K, C, M (mode, mode), with
    fingers where `with_fingers` has put some.
    """

    device: Device
    functions: Functions
    shape: Array
    moved: Array
    K: Array
    C: Array
    M: Array
    known: KnownDrive | None = None

    @property
    def size(self) -> int:
        """Number of degrees of freedom."""
        return len(self.K)

    @property
    def actuators(self) -> Sampler:
        """The deflection that each actuator's spring and damper act on; relative to its moving mass, if it has one."""
        rows = self._at_actuators.copy()
        rows[[actuator.is_inertial for actuator in self.device.actuators]] -= self.moved
        return _of_modes(rows)

    @property
    def masses(self) -> Sampler:
        """The deflection of each mass of `moved_masses`."""
        return _of_modes(np.concatenate([self._at_actuators, self.moved]))

    @cached_property
    def _at_actuators(self) -> Array:
        return self.sampler(np.array([actuator.position_m for actuator in self.device.actuators])).weight

    def sampler(self, position_m: Array | Complex) -> Sampler:
        """Sampler at points (point,) on the surface."""
        return _of_modes(self.functions.at(position_m) @ self.shape)

    def rebuilt(self, device: Device, K: Array, M: Array) -> Self:
        """The plant of a device with other values, on the same modes: K and M (mode, mode) are of its surface alone."""
        at = self.sampler(np.array([actuator.position_m for actuator in device.actuators])).weight
        K, C, M = _with_actuators(device, at, self.moved, K, M)
        return replace(self, device=device, K=K, C=C, M=M)

    def through(self, position_m: Points) -> Array:
        """The least bent fields through the points, which are held by stiff springs."""
        rows, energy = self.sampler(position_m).weight, self.shape.T @ self.functions.bending @ self.shape
        spring = _HELD * energy.diagonal().max() / (rows**2).mean()
        return np.asarray(np.linalg.solve(energy + spring * rows.T @ rows, spring * rows.T), dtype=np.float64)

    def _loaded(self, position_m: Sequence[complex], fingers: Sequence[Finger]) -> Self:
        """The plant with these fingers at these points."""
        rows = self.sampler(np.array(position_m)).weight
        stiffness, damping, mass = (
            np.array([getattr(each, key) for each in fingers])
            for key in ("stiffness_n_per_m", "damping_n_s_per_m", "mass_kg")
        )
        K, C, M = (
            own + (rows.T * added) @ rows for own, added in ((self.K, stiffness), (self.C, damping), (self.M, mass))
        )
        return replace(self, K=K, C=C, M=M)

    @property
    def resolution(self) -> dict[str, int | float]:
        """How finely the functions resolve the surface."""
        return self.functions.resolution

    def dense(self) -> tuple[Array, Array, Array]:
        """K, C and M (degree of freedom, degree of freedom)."""
        return self.K, self.C, self.M

    def solve(self, omega: Array, loads: Sampler, spring: Array, damper: Array) -> Complex:
        """Displacement (frequency, load, degree of freedom), by elimination."""
        force = np.zeros((len(loads.dof), self.size))
        np.put_along_axis(force, loads.dof, loads.weight, axis=1)
        out = np.empty((len(omega), *force.shape), dtype=np.complex128)
        with threadpool_limits(1, "blas"):  # threads cost more than systems of this size gain by them
            for at, w in enumerate(omega):
                right = (spring + 1j * w * damper)[:, None] * force
                out[at] = np.linalg.solve(self.K + 1j * w * self.C - w**2 * self.M, right.T).T
        return out

    def gram(self, field: Complex) -> Complex:
        """Integrals (frequency, zone + 1, column, column) of conj(v_a) v_b, exact."""
        found = [np.einsum("fai,ij,fbj->fab", field.conj(), each, field, optimize=True) for each in self._integrals]
        return np.stack(found, axis=1)

    @cached_property
    def _integrals(self) -> list[Array]:
        """Integrals (mode, mode) of products over each zone, and over what is in none."""
        corner_m = self.device.surface.corner_m
        whole = self.integral_over(0 * corner_m, corner_m)
        each = [self.integral_over(zone.start_m, zone.stop_m) for zone in self.device.zones]
        return [*each, whole - sum(each, np.zeros_like(whole))]

    def integral_over(self, start_m: complex, stop_m: complex) -> Array:
        """Integrals (mode, mode) of products over a stretch of a bar, m, or a rectangle of a plate, m^2."""
        return self.shape.T @ self.functions.mean_products(start_m, stop_m) @ self.shape


def _of_modes(weight: Array) -> Sampler:
    return ModeSampler(np.broadcast_to(np.arange(weight.shape[1]), weight.shape), weight)


def assemble_modes(device: Device, functions: Functions, K: Array, M: Array) -> ModalPlant:
    """The plant of an untouched surface, K and M (function, function), with its actuators; C = C_A + sigma M + eta K.

    M and K there are the surface's own, or with `damping_of` "assembly" the whole plant's. Sigma damps the masses of
    inertial actuators either way: they are attached to nothing but the surface.
    """
    actuators, own = device.actuators, len(K)
    inertial = sum(actuator.is_inertial for actuator in actuators)
    K, M = (np.pad(each, (0, inertial)) for each in (K, M))
    at = np.pad(functions.at(np.array([actuator.position_m for actuator in actuators])), ((0, 0), (0, inertial)))
    K, C, M = _with_actuators(device, at, np.eye(inertial, len(K), own), K, M)
    last = min(_MOST_MODES, len(K)) - 1
    square, shape = scipy.linalg.eigh(K, M, subset_by_index=(0, last))
    square, C = np.diag(np.maximum(square, 0.0)), shape.T @ C @ shape
    return ModalPlant(device, functions, shape[:own], shape[own:], square, C, np.eye(len(square)))


def _with_actuators(device: Device, at: Array, moving: Array, K: Array, M: Array) -> tuple[Array, Array, Array]:
    """K, C and M of a surface with its actuators.

    at (actuator, function): deflections at the actuators; moving (inertial actuator, function): of moving masses.
    """
    surface, actuators = device.surface, device.actuators
    inertial = np.flatnonzero([actuator.is_inertial for actuator in actuators])
    springs, masses = at.copy(), np.concatenate([at, moving])
    springs[inertial] -= moving
    stiffness, damping = np.array([(each.stiffness_n_per_m, each.damping_n_s_per_m) for each in actuators]).T
    held = np.array([each.grounded_mass_kg for each in actuators] + [0.0] * len(inertial))
    mass = moved_masses(actuators)
    floating = (masses.T * (mass - held)) @ masses
    of_surface = surface.mass_damping_per_s * (M + floating) + surface.stiffness_damping_s * K
    K, M = K + (springs.T * stiffness) @ springs, M + (masses.T * mass) @ masses
    of_both = surface.mass_damping_per_s * M + surface.stiffness_damping_s * K
    return K, (of_surface if surface.damping_of == "bar" else of_both) + (springs.T * damping) @ springs, M
