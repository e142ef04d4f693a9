"""Laws of one element: what a cubic Hermite beam element is, found again by integration."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from precompute.model.element import shape_functions, shape_integral, stiffness_matrix
from tests.precompute.devices import unhurried

lengths = st.floats(1e-4, 10.0)
stiffnesses = st.floats(1e-3, 1e3)
Array = NDArray[np.float64]


def shapes(length_m: float) -> list[Polynomial]:
    """The four cubics in x with value or slope 1 at one end, and 0 at the three others; solved, not remembered."""
    conditions = [[x**k for k in range(4)] for x in (0.0, 1.0)], [[0.0, 1.0, 2 * x, 3 * x * x] for x in (0.0, 1.0)]
    rows = np.array([conditions[0][0], conditions[1][0], conditions[0][1], conditions[1][1]])
    scale = (1.0, length_m, 1.0, length_m)
    return [
        Polynomial(s * column, [0, length_m], [0, 1]) for s, column in zip(scale, np.linalg.inv(rows).T, strict=True)
    ]


def integrals(first: list[Polynomial], length_m: float) -> Array:
    return np.array([[(a * b).integ()(length_m) - (a * b).integ()(0.0) for b in first] for a in first])


def assert_close(found: Array, expected: Array) -> None:
    """Equal within the rounding of the largest entry of each row and column (slopes and deflections differ in unit)."""
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert (np.abs(found - expected) <= 1e-12 * size).all()


@unhurried
@given(lengths)
def test_shape_functions_are_the_unit_cubics_of_each_degree_of_freedom(length_m: float) -> None:
    xi = np.linspace(0.0, 1.0, 7)
    found = shape_functions(xi, np.full(7, length_m))
    assert found.shape == (7, 4)
    for column, shape in zip(found.T, shapes(length_m), strict=True):
        assert column == pytest.approx(shape(xi * length_m), abs=1e-12 * max(1.0, length_m))


@unhurried
@given(lengths)
def test_mass_integral_is_the_integral_of_the_shapes(length_m: float) -> None:
    assert_close(shape_integral(length_m), integrals(shapes(length_m), length_m))


@unhurried
@given(lengths, stiffnesses)
def test_stiffness_is_the_integral_of_the_curvatures(length_m: float, bending: float) -> None:
    curvatures = [shape.deriv(2) for shape in shapes(length_m)]
    assert_close(stiffness_matrix(bending, length_m), bending * integrals(curvatures, length_m))
