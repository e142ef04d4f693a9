"""Laws of least absolute residuals: exact despite wrong data, within bounds, never worse than a neighbour."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from base.arrays import Array
from precompute.calibration.least_absolute import solve_least_absolute

FAR = np.full(3, 10.0)
seeds = st.integers(0, 2**32 - 1)
few = settings(max_examples=settings().max_examples // 3)


def curve(seed: int, data: int = 40) -> tuple[Array, Array]:
    """Rows of a model that bends, and parameters."""
    random = np.random.default_rng(seed)
    return random.normal(size=(data, 3)), random.uniform(-0.5, 0.5, 3)


def value_of(rows: Array, point: Array) -> Array:
    out: Array = np.exp(0.3 * rows @ point) + rows @ point
    return out


def slope_of(rows: Array, point: Array) -> Array:
    out: Array = rows * (0.3 * np.exp(0.3 * rows @ point) + 1)[:, None]
    return out


def solved(rows: Array, measured: Array, low: Array, high: Array) -> Array:
    return solve_least_absolute(
        lambda x: (value_of(rows, x) - measured, slope_of(rows, x)), np.zeros(3), low, high, 1e-13
    )


@few
@given(seeds)
def test_a_tenth_of_the_data_may_be_anything(seed: int) -> None:
    rows, truth = curve(seed)
    measured = value_of(rows, truth)
    measured[:4] += np.array([3.0, -5.0, 8.0, -2.0])
    assert np.abs(solved(rows, measured, -FAR, FAR) - truth).max() < 1e-8


@few
@given(seeds)
def test_no_neighbour_is_better(seed: int) -> None:
    rows, truth = curve(seed)
    random = np.random.default_rng(seed + 1)
    measured = value_of(rows, truth) + 0.2 * random.standard_t(2, len(rows))
    found = solved(rows, measured, -FAR, FAR)
    cost = np.abs(value_of(rows, found) - measured).sum()
    for _ in range(50):
        other = found + random.normal(size=3) * 10 ** random.uniform(-5, -1)
        assert np.abs(value_of(rows, other) - measured).sum() >= cost * (1 - 1e-9)


@few
@given(seeds)
def test_bounds_hold(seed: int) -> None:
    rows, truth = curve(seed)
    low, high = np.array([-0.1, -0.1, -0.1]), np.array([0.1, 0.1, 0.1])
    found = solved(rows, value_of(rows, truth), low, high)
    assert (found >= low).all() and (found <= high).all()
    outside = (truth < low) | (truth > high)
    if outside.all():
        assert np.isclose(abs(found), 0.1).any()
