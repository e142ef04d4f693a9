"""Law of the unit responses: the kernel solves any band.

That they are those of the dense model is a law of tests/precompute/sweep/test_grid.py and sampling/test_places.py.
"""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from precompute.model.assembly import BANDWIDTH, dense
from precompute.model.band_solver import solve_banded


@given(st.integers(1, 40), st.integers(0, 2**32))
def test_banded_kernel_solves_any_band_even_where_pivots_are_small(size: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    K, C, M = random.normal(size=(3, BANDWIDTH + 1, size))
    K[-1] *= random.choice([0.0, 1e-12, 1.0], size)  # diagonal that only pivoting survives
    C[-1] *= 1e-3
    M[-1] = 0.0
    dof, spring, damper = np.array([size // 2]), np.array([1.5]), np.array([0.25])
    out = np.zeros((2, 1, size), dtype=complex)
    omega = np.array([0.3, 2.0])
    weight = np.zeros((1, 4))
    weight[0, : min(4, size - size // 2)] = random.normal(size=min(4, size - size // 2))
    solve_banded(K, C, M, omega, dof, weight, spring, damper, out)
    for w, found in zip(omega, out[:, 0], strict=True):
        matrix = dense(K) + 1j * w * dense(C) - w * w * dense(M)
        right = np.zeros(size, dtype=complex)
        right[size // 2 : size // 2 + 4] = (1.5 + 0.25j * w) * weight[0, : size - size // 2]
        scale = np.abs(matrix).sum(axis=1).max() * np.abs(found).max() + np.abs(right).max()
        assert np.abs(matrix @ found - right).max() <= 1e-12 * scale
