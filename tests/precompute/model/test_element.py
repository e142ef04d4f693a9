"""The law of one element: its matrices are the integrals of the products of the cubics and of their curvatures."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from precompute.model.element import shape_integral, stiffness_matrix
from tests.precompute.dense_model import hermite, integral
from tests.precompute.devices import unhurried


@unhurried
@given(st.floats(0.01, 10.0), st.floats(1e-3, 1e3))
def test_mass_and_stiffness_are_integrals_of_shapes_and_curvatures(length_m: float, bending: float) -> None:
    shapes = hermite(length_m)
    mass, stiffness = (integral(shapes, length_m, derivative) for derivative in (0, 2))
    for found, expected in (
        (shape_integral(length_m), mass),
        (stiffness_matrix(bending, length_m), bending * stiffness),
    ):
        size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))  # slopes and deflections differ in unit
        assert (abs(found - expected) <= 1e-9 * size).all()
