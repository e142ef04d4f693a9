"""One Euler-Bernoulli element with cubic Hermite shape functions: deflection and slope at each end."""

import numpy as np

from base.arrays import Array


def stiffness_matrix(bending_stiffness_n_m2: float, length_m: float) -> Array:
    """Shape (4, 4): integral of EI N'' N''^T, degrees of freedom (y0, slope0, y1, slope1); paper eq. (1)."""
    a = length_m
    matrix = [
        [12.0, 6 * a, -12.0, 6 * a],
        [6 * a, 4 * a * a, -6 * a, 2 * a * a],
        [-12.0, -6 * a, 12.0, -6 * a],
        [6 * a, 2 * a * a, -6 * a, 4 * a * a],
    ]
    return bending_stiffness_n_m2 / a**3 * np.array(matrix)


def shape_integral(length_m: float) -> Array:
    """Shape (4, 4), in metres: integral of N N^T over the element; times mass per length it is the mass matrix."""
    a = length_m
    matrix = [
        [156.0, 22 * a, 54.0, -13 * a],
        [22 * a, 4 * a * a, 13 * a, -3 * a * a],
        [54.0, 13 * a, 156.0, -22 * a],
        [-13 * a, -3 * a * a, -22 * a, 4 * a * a],
    ]
    return a / 420 * np.array(matrix)


def shape_functions(xi: Array, length_m: Array) -> Array:
    """Shape (..., 4): N at `xi` = 0..1 along elements of `length_m`."""
    at_start = 1 - 3 * xi**2 + 2 * xi**3, length_m * (xi - 2 * xi**2 + xi**3)
    return np.stack([*at_start, 3 * xi**2 - 2 * xi**3, length_m * (xi**3 - xi**2)], axis=-1)
