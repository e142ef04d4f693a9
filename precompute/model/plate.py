"""Rectangular Kirchhoff plate with free edges by Ritz's method: products of Legendre polynomials span its motion.

The strain energy of bending and the kinetic energy are exact integrals of the products, and
`precompute.model.modal_plant` puts actuators on them. Polynomials have no mesh, converge exponentially where the motion
is smooth, and near a point that is driven as fast as its logarithmic curvature lets them.

The number of functions follows from the shortest wave along each side (`degrees_of`).
Sources: A. W. Leissa, Vibration of Plates, NASA SP-160, 1969 (energies, eq. (1.10); free plates, table 4.74 ff.).
"""

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from base.arrays import Array, Points
from engine.device.parts import Plate

_MARGIN = 24
"""Degrees beyond half the wave number times the side: receptances on point springs are then right to 0.1 dB."""


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

    def at(self, points_m: Points) -> Array:
        """The functions at points (point,): (point, function)."""
        x, y = (2 * np.real(points_m) / self.length_m - 1), (2 * np.imag(points_m) / self.width_m - 1)
        along, across = legendre.legvander(x, int(self.first.max())), legendre.legvander(y, int(self.second.max()))
        values: Array = along[:, self.first] * across[:, self.second]
        return values

    @property
    def resolution(self) -> dict[str, int | float]:
        """Number of functions."""
        return {"ritz_functions": len(self.first)}

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
