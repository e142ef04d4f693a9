"""Rectangular Kirchhoff plate with free edges by Ritz's method: products of Legendre polynomials span its motion.

The strain energy of bending and the kinetic energy are exact integrals of the products, and
`precompute.model.modal_plant` puts actuators on them. Polynomials have no mesh, converge exponentially where the motion
is smooth, and near a point that is driven as fast as its logarithmic curvature lets them.

The number of functions follows from the shortest wave along each side (`degrees_of`).
Sources: A. W. Leissa, Vibration of Plates, NASA SP-160, 1969 (energies, eq. (1.10); free plates, table 4.74 ff.).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.polynomial import legendre

from base.arrays import Array, Complex, Integers, Points
from engine.device import Device
from engine.device.parts import Plate
from precompute.model.modal_plant import ModalPlant, assemble_modes
from precompute.model.plant import FreeSurface

_MARGIN = 24  # degrees beyond half the wave number times the side: receptances on springs are right to 0.1 dB


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
    first: Integers
    second: Integers

    @classmethod
    def of(cls, plate: Plate, degrees: tuple[int, int]) -> "Ritz":
        """The functions below the diagonal of the highest degrees."""
        i, j = np.meshgrid(np.arange(degrees[0]), np.arange(degrees[1]), indexing="ij")
        kept = i / degrees[0] + j / degrees[1] < 1.05
        return cls(plate.length_m, plate.width_m, i[kept], j[kept])

    def at(self, points_m: Points) -> Array:
        """The functions at points (point,): (point, function)."""
        x, y = (2 * np.real(points_m) / self.length_m - 1), (2 * np.imag(points_m) / self.width_m - 1)
        along, across = legendre.legvander(x, int(self.first.max())), legendre.legvander(y, int(self.second.max()))
        return along[:, self.first] * across[:, self.second]

    @property
    def resolution(self) -> dict[str, int | float]:
        """Number of functions."""
        return {"ritz_functions": len(self.first)}

    def mean_products(self, start_m: complex, stop_m: complex) -> Array:
        """Integral of f_k f_l over a rectangle: (function, function), m^2."""
        sides = (start_m.real, stop_m.real, self.length_m), (start_m.imag, stop_m.imag, self.width_m)
        (x, y) = (_products(degree, *side) for degree, side in zip((self.first, self.second), sides, strict=True))
        return x * y

    @property
    def bending(self) -> Array:
        """Strain energy of bending (function, function) at a bending stiffness of 1 without Poisson's ratio."""
        return self.energies[0]

    @cached_property
    def energies(self) -> tuple[Array, Array, Array]:
        """Bending energy at a bending stiffness of 1 without Poisson's ratio, its part times that, and the mass of 1.

        (function, function) each: K = D (first + nu second), M = rho h third.
        """
        (x0, x1, x2), (y0, y1, y2) = (_derivatives(degree) for degree in (self.first, self.second))
        area, along, across = self.length_m * self.width_m / 4, (2 / self.length_m) ** 2, (2 / self.width_m) ** 2

        def pair(x: Array, y: Array, degree_x: Array, degree_y: Array) -> Array:
            return np.asarray((x @ degree_x.T) * (y @ degree_y.T))

        bending = along**2 * pair(x2, y0, x2, y0) + across**2 * pair(x0, y2, x0, y2)
        mixed = pair(x2, y0, x0, y2) + pair(x0, y2, x2, y0)
        twist = pair(x1, y1, x1, y1)
        plain = bending + 2 * along * across * twist
        return area * plain, area * along * across * (mixed - 2 * twist), area * pair(x0, y0, x0, y0)


def _products(degree: Integers, start_m: float, stop_m: float, side_m: float) -> Array:
    """Integral of P_i P_j over a part of a side, by the degrees of two functions: (function, function), m."""
    top = int(degree.max()) + 1
    node, weight = legendre.leggauss(top)
    at = (start_m + stop_m + (stop_m - start_m) * node) / side_m - 1
    values = legendre.legvander(at, top - 1)
    square: Array = (values.T * weight) @ values * (stop_m - start_m) / 2
    return square[np.ix_(degree, degree)]


def plate_matrices(plate: Plate, energies: Sequence[Array]) -> tuple[Array, Array]:
    """Stiffness and mass of the plate alone from `Ritz.energies`, or from those of its modes."""
    plain, by_poisson, mass = energies
    return (
        plate.bending_n_m * (plain + plate.poissons_ratio * by_poisson),
        plate.density_kg_per_m3 * plate.thickness_m * mass,
    )


def assemble_plate(device: Device) -> ModalPlant:
    """The plant of an untouched plate with its actuators."""
    plate = device.surface
    assert isinstance(plate, Plate)
    ritz = Ritz.of(plate, degrees_of(plate, device.sweep.stop_hz))
    return assemble_modes(device, ritz, *plate_matrices(plate, ritz.energies))


class FreePlate(FreeSurface):
    """A plate without its actuators. Its functions are the modes of the device with them, whatever its values become.

    Readings are then those of a plate with modes of its own to 1e-4 of the greatest, and with another Poisson's ratio
    to a fortieth of its relative change.
    """

    def __init__(self, device: Device) -> None:
        self._base = assemble_plate(device)
        functions, shape = self._base.functions, self._base.shape
        assert isinstance(functions, Ritz)
        self._energies = [shape.T @ each @ shape for each in functions.energies]

    def plant(self, device: Device) -> ModalPlant:
        """The plant of a device whose plate has the same lengths."""
        plate = device.surface
        assert isinstance(plate, Plate)
        return self._base.rebuilt(device, *plate_matrices(plate, self._energies))

    def strain(self, device: Device, one: Complex, other: Complex) -> dict[str, Complex]:
        """Derivatives of one^T K other (row,) by Young's modulus and Poisson's ratio."""
        plate = device.surface
        assert isinstance(plate, Plate)
        bent, coupled = (_between(one, energy, other) for energy in self._energies[:2])
        nu, D = plate.poissons_ratio, plate.bending_n_m
        both = bent + nu * coupled
        return {
            "youngs_modulus": D / plate.youngs_modulus_pa * both,
            "poissons_ratio": D * (2 * nu / (1 - nu**2) * both + coupled),
        }

    def motion(self, device: Device, one: Complex, other: Complex) -> Complex:
        """Derivative of one^T M other (row,) by the density."""
        return device.surface.thickness_m * _between(one, self._energies[2], other)


def _between(one: Complex, matrix: Array, other: Complex) -> Complex:
    """one^T matrix other (row,)."""
    # Two real products take half the time of the complex one that other @ matrix would be.
    return (one * (other.real @ matrix + 1j * (other.imag @ matrix))).sum(axis=1)


def _derivatives(degree: Integers) -> tuple[Array, Array, Array]:
    """Each function's polynomial and its first two derivatives at Gauss's nodes, times the root of their weights."""
    top = int(degree.max()) + 1
    node, weight = legendre.leggauss(top)
    found = []
    for order in range(3):
        values = np.stack([legendre.legval(node, legendre.legder(one, order)) for one in np.eye(top)])
        found.append(np.asarray((values * np.sqrt(weight))[degree], dtype=np.float64))
    return found[0], found[1], found[2]
