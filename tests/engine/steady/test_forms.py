"""Packed Hermitian forms and their ascent against dense matrices."""

import numpy as np
import pytest

from base.arrays import Array, Complex
from engine.steady.ascent import evaluate
from engine.steady.forms import fill_products, multiply, power_of, solve


def packed(matrix: Complex) -> Array:
    """The diagonal, then real and imaginary parts of the elements above it, row by row."""
    above = matrix[np.triu_indices(len(matrix), 1)]
    return np.concatenate([matrix.diagonal().real, np.stack([above.real, above.imag], axis=1).ravel()])


def random_forms(random: np.random.Generator, count: int, actuators: int) -> Complex:
    factor = random.normal(size=(count, actuators, actuators)) + 1j * random.normal(size=(count, actuators, actuators))
    forms: Complex = factor.conj().transpose(0, 2, 1) @ factor
    return forms


@pytest.mark.parametrize("actuators", [1, 2, 3, 5])
def test_packed_forms_are_the_dense_ones(actuators: int) -> None:
    random = np.random.default_rng(actuators)
    matrix = random_forms(random, 1, actuators)[0]
    a = random.normal(size=actuators) + 1j * random.normal(size=actuators)
    products, image, found = np.empty(actuators**2), np.empty_like(a), np.empty_like(a)
    fill_products(a, products)
    assert power_of(packed(matrix), products) == pytest.approx((a.conj() @ matrix @ a).real)
    multiply(packed(matrix), a, image)
    assert image == pytest.approx(matrix @ a)
    solve(packed(matrix), a, found, np.empty((actuators, actuators), dtype=np.complex128))
    exact = np.linalg.solve(matrix, a)
    assert found / found[0] == pytest.approx(exact / exact[0])  # its length is free


@pytest.mark.parametrize("actuators", [2, 3])
@pytest.mark.parametrize("log_wanted", [-5.0, 0.0, 5.0])
def test_the_gradient_is_that_of_the_objective(actuators: int, log_wanted: float) -> None:
    random = np.random.default_rng(3)
    forms = np.array([packed(each) for each in random_forms(random, 5, actuators)])
    a = random.normal(size=actuators) + 1j * random.normal(size=actuators)
    usable, gradient = np.ones(actuators, dtype=np.bool_), np.empty(actuators, dtype=np.complex128)
    work = np.empty((4, 5 + actuators**2))

    def value_at(drive: Complex, out: Complex) -> float:
        return float(evaluate(drive, usable, forms, 2, 2, log_wanted, 10.0, out, work))

    value_at(a, gradient)
    for direction in (np.eye(actuators)[0] + 0j, 1j * np.eye(actuators)[1]):
        step = 1e-6 * direction
        slope = (value_at(a + step, np.empty_like(a)) - value_at(a - step, np.empty_like(a))) / 2e-6
        assert slope == pytest.approx((direction.conj() @ gradient).real, rel=1e-5, abs=1e-6)
