"""Rectangular Kirchhoff plate with free edges by Ritz's method: products of Legendre polynomials span its motion.

The strain energy of bending and the kinetic energy are exact integrals of the products; actuators and fingers enter as
springs, dampers and masses at points, exactly as on a bar. Polynomials have no mesh, converge exponentially where the
motion is smooth, and near a point that is driven as fast as its logarithmic curvature lets them.

The number of functions follows from the shortest wave along each side (`degrees_of`).
Sources: A. W. Leissa, Vibration of Plates, NASA SP-160, 1969 (energies, eq. (1.10); free plates, table 4.74 ff.).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
import scipy.linalg
from numpy.polynomial import legendre
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from base.arrays import Array, Complex, even_points
from engine.device import Device, Finger
from engine.device.parts import Plate
from precompute.model.plant import Plant, Sampler

_MARGIN = 24
"""Degrees beyond half the wave number times the side: receptances on point springs are then right to 0.1 dB."""
_MOST_MODES = 150
"""Modes that stand for the plate. Those above, at about 10 kHz on a tablet, would be as stiff as 3 MN/m at a point."""
_ROWS = 17
"""Points looked at across a zone, and along it, for peaks."""


def degrees_of(plate: Plate, top_hz: float) -> tuple[int, int]:
    """Numbers of polynomials along and across the plate for motion up to a frequency."""
    half_wave = plate.wave_number_per_m(top_hz) / 2
    along, across = (int(np.ceil(half_wave * side_m)) + _MARGIN for side_m in (plate.length_m, plate.width_m))
    return along, across


@dataclass(frozen=True)
class Ritz:
    """Functions P_i(x) P_j(y) on a plate, scaled to -1 to 1 each way; those of low degree in both are kept.

    first, second (function,): the degrees along and across.
    """

    length_m: float
    width_m: float
    first: NDArray[np.int64]
    second: NDArray[np.int64]

    @classmethod
    def of(cls, plate: Plate, degrees: tuple[int, int]) -> "Ritz":
        """The functions below the diagonal of the highest degrees."""
        i, j = np.meshgrid(np.arange(degrees[0]), np.arange(degrees[1]), indexing="ij")
        kept = i / degrees[0] + j / degrees[1] < 1.05
        return cls(plate.length_m, plate.width_m, i[kept], j[kept])

    def at(self, points_m: NDArray[np.complex128]) -> Array:
        """The functions at points (point,): (point, function)."""
        x, y = (2 * np.real(points_m) / self.length_m - 1), (2 * np.imag(points_m) / self.width_m - 1)
        along, across = legendre.legvander(x, int(self.first.max())), legendre.legvander(y, int(self.second.max()))
        values: Array = along[:, self.first] * across[:, self.second]
        return values

    def mean_products(self, start_m: complex, stop_m: complex) -> Array:
        """Integral of f_k f_l over a rectangle: (function, function), m^2."""
        sides = (start_m.real, stop_m.real, self.length_m), (start_m.imag, stop_m.imag, self.width_m)
        (x, y) = (_products(degree, *side) for degree, side in zip((self.first, self.second), sides, strict=True))
        return x * y


def _products(degree: NDArray[np.int64], start_m: float, stop_m: float, side_m: float) -> Array:
    """Integral of P_i P_j over a part of a side, by the degrees of two functions: (function, function), m."""
    top = int(degree.max()) + 1
    node, weight = legendre.leggauss(top)
    at = (start_m + stop_m + (stop_m - start_m) * node) / side_m - 1
    values = legendre.legvander(at, top - 1)
    square: Array = (values.T * weight) @ values * (stop_m - start_m) / 2
    return square[np.ix_(degree, degree)]


def plate_matrices(plate: Plate, ritz: Ritz) -> tuple[Array, Array]:
    """Stiffness and mass of the plate alone: (function, function) each."""
    (x0, x1, x2), (y0, y1, y2) = (_derivatives(degree) for degree in (ritz.first, ritz.second))
    nu, area = plate.poissons_ratio, plate.length_m * plate.width_m / 4
    along, across = (2 / plate.length_m) ** 2, (2 / plate.width_m) ** 2

    def product(one: Array, other: Array) -> Array:
        return np.asarray(one @ other.T)

    def pair(x: Array, y: Array, degree_x: Array, degree_y: Array) -> Array:
        return product(x, degree_x) * product(y, degree_y)

    bending = along**2 * pair(x2, y0, x2, y0) + across**2 * pair(x0, y2, x0, y2)
    mixed = pair(x2, y0, x0, y2) + pair(x0, y2, x2, y0)
    twist = pair(x1, y1, x1, y1)
    K = plate.bending_n_m * area * (bending + along * across * (nu * mixed + 2 * (1 - nu) * twist))
    M = plate.density_kg_per_m3 * plate.thickness_m * area * pair(x0, y0, x0, y0)
    return K, M


def _derivatives(degree: NDArray[np.int64]) -> tuple[Array, Array, Array]:
    """Each function's polynomial and its first two derivatives at Gauss's nodes, times the root of their weights."""
    top = int(degree.max()) + 1
    node, weight = legendre.leggauss(top)
    found = []
    for order in range(3):
        values = np.stack([legendre.legval(node, legendre.legder(one, order)) for one in np.eye(top)])
        found.append(np.asarray((values * np.sqrt(weight))[degree], dtype=np.float64))
    return found[0], found[1], found[2]


class ModeSampler(Sampler):
    """A sampler whose every point sees all degrees of freedom: one product, without a copy of the field a point."""

    def sample(self, field: Complex) -> Complex:
        """Shape (..., point) from a field (..., degree of freedom)."""
        return np.asarray(field @ self.weight.T)

    def shapes(self, shape: Array) -> Array:
        """Shape (point, mode) from mode shapes (degree of freedom, mode)."""
        return np.asarray(self.weight @ shape)


@dataclass(frozen=True)
class PlatePlant(Plant):
    """A plate on its actuators; its degrees of freedom are the undamped modes of both together, mass-normalised.

    shape (function, mode); K, C, M (mode, mode), with fingers where `with_fingers` has put some.
    """

    device: Device
    ritz: Ritz
    shape: Array
    K: Array
    C: Array
    M: Array

    @property
    def size(self) -> int:
        """Number of degrees of freedom."""
        return len(self.K)

    @property
    def actuators(self) -> Sampler:
        """The deflection at each actuator, which its spring and damper act on."""
        return self.sampler(np.array([actuator.position_m for actuator in self.device.actuators]))

    def sampler(self, position_m: NDArray[np.float64] | NDArray[np.complex128]) -> Sampler:
        """Sampler at points (point,) on the plate."""
        weight = self.ritz.at(np.asarray(position_m, dtype=np.complex128)) @ self.shape
        return ModeSampler(np.broadcast_to(np.arange(self.size), weight.shape), weight)

    def with_fingers(self, position_m: Sequence[complex], finger: Finger | Sequence[Finger]) -> "PlatePlant":
        """The plant with a grounded finger at each point (docs/theory.md#fingers)."""
        fingers = [finger] * len(position_m) if isinstance(finger, Finger) else list(finger)
        rows = self.sampler(np.array(position_m, dtype=np.complex128)).weight
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
        """Number of Ritz's functions."""
        return {"ritz_functions": len(self.ritz.first)}

    def with_device(self, device: Device) -> Self:
        """The same matrices for a device that differs in what they do not depend on."""
        return replace(self, device=device)

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
        whole = self.integral_over(0j, self.device.surface.corner_m)
        each = [self.integral_over(zone.start_m, zone.stop_m) for zone in self.device.zones]
        return [*each, whole - sum(each, np.zeros_like(whole))]

    def integral_over(self, start_m: complex, stop_m: complex) -> Array:
        """Integrals (mode, mode) of products over a rectangle, m^2."""
        return self.shape.T @ self.ritz.mean_products(start_m, stop_m) @ self.shape

    @property
    def zone_places_m(self) -> NDArray[np.complex128]:
        """Points (zone, row, column) in each zone, edges included."""
        each = [even_points(zone.start_m, zone.stop_m, _ROWS, _ROWS) for zone in self.device.zones]
        return np.array(each).reshape(-1, _ROWS, _ROWS)


def assemble_plate(device: Device) -> PlatePlant:
    """The plant of an untouched plate with its actuators; C = C_A + sigma M + eta K, as on a bar.

    M and K there are the plate's own, or with `damping_of` "assembly" the whole plant's.
    """
    plate = device.surface
    assert isinstance(plate, Plate)
    ritz = Ritz.of(plate, degrees_of(plate, device.sweep.stop_hz))
    K, M = plate_matrices(plate, ritz)
    rows = ritz.at(np.array([actuator.position_m for actuator in device.actuators]))
    stiffness, damping, mass = (
        np.array([getattr(actuator, key) for actuator in device.actuators])
        for key in ("stiffness_n_per_m", "damping_n_s_per_m", "mass_kg")
    )
    of_plate = plate.mass_damping_per_s * M + plate.stiffness_damping_s * K
    K, M = K + (rows.T * stiffness) @ rows, M + (rows.T * mass) @ rows
    of_both = plate.mass_damping_per_s * M + plate.stiffness_damping_s * K
    C = (of_plate if plate.damping_of == "bar" else of_both) + (rows.T * damping) @ rows
    last = min(_MOST_MODES, len(K)) - 1
    square, shape = scipy.linalg.eigh(K, M, subset_by_index=(0, last))
    return PlatePlant(device, ritz, shape, np.diag(np.maximum(square, 0.0)), shape.T @ C @ shape, np.eye(len(square)))
