"""Laws of the search's kernels: equal to plain NumPy, gradients to finite differences, one ratio to its eigenvalue."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import eigh

from precompute.entries.ascent import PENALTY, SHARPEST, climb, evaluate
from precompute.entries.bfgs import climb_each, interpolate, refine
from precompute.entries.objective import Problem
from tests.precompute.entries.problems import powers, random_forms, random_problem

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
few = settings(deadline=None, max_examples=settings().max_examples // 3)
seeds = st.integers(0, 2**32 - 1)
counts = st.tuples(st.integers(1, 3), st.integers(1, 3), st.integers(1, 3))
actuator_counts = st.integers(1, 4)
ANYTHING = -700.0


def random_drive(seed: int, actuators: int) -> Complex:
    parts = np.random.default_rng(seed).normal(size=(2, actuators))
    drive: Complex = parts[0] + 1j * parts[1]
    return drive


def first_forms(problem: Problem) -> list[Complex]:
    """Numerators, denominators and levels at the first frequency."""
    return [np.ascontiguousarray(stack[:, 0]) for stack in problem.stacks]


def evaluated(
    problem_seed: int, drive: Complex, sizes: tuple[int, int, int], log_wanted: float, beta: float
) -> tuple[float, Array, Array]:
    """Value, gradient and multipliers at the first frequency of a random problem."""
    numerator, denominator, level = first_forms(random_problem(problem_seed, len(drive), sizes))
    gradient, (multipliers, logs) = np.empty(2 * len(drive)), np.empty((2, sum(sizes) + len(drive)))
    usable = np.ones(len(drive), dtype=bool)
    value = evaluate(
        drive, usable, numerator, denominator, level, log_wanted, beta, gradient, multipliers, logs, PENALTY
    )
    return value, gradient, multipliers


@few
@given(seeds, actuator_counts, counts, st.floats(-4.0, 4.0), st.sampled_from([3.0, 30.0, 300.0]))
def test_the_gradient_is_that_of_finite_differences(
    seed: int, actuators: int, sizes: tuple[int, int, int], log_wanted: float, beta: float
) -> None:
    drive = random_drive(seed, actuators)
    _, gradient, _ = evaluated(seed, drive, sizes, log_wanted, beta)
    step = 1e-6 / beta**0.5
    for k in range(2 * actuators):
        moved = np.zeros(actuators, dtype=np.complex128)
        moved[k // 2] = step if k % 2 == 0 else 1j * step
        above, below = (evaluated(seed, drive + s * moved, sizes, log_wanted, beta)[0] for s in (1, -1))
        assert (above - below) / (2 * step) == pytest.approx(
            gradient[k], rel=1e-4, abs=1e-4 * abs(gradient).max() + 1e-5
        )


@few
@given(seeds, actuator_counts, counts, st.floats(-4.0, 4.0))
def test_the_smoothed_value_is_below_the_true_one_by_no_more_than_the_sharpness_allows(
    seed: int, actuators: int, sizes: tuple[int, int, int], log_wanted: float
) -> None:
    drive = random_drive(seed, actuators)
    value, _, multipliers = evaluated(seed, drive, sizes, log_wanted, SHARPEST)
    tone, place = np.zeros((2, 1, actuators), dtype=np.int64)
    numerator, denominator, level = (
        powers(stack, tone, place, drive[None])[:, 0] for stack in random_problem(seed, actuators, sizes).stacks
    )
    missing = max(0.0, log_wanted + np.log((abs(drive) ** 2).max() / level.min()))
    true = np.log(numerator.min() / denominator.max()) - PENALTY * missing
    most = np.log(max(*sizes, actuators)) / SHARPEST
    assert true - 2 * most - PENALTY * (2 * most + np.log(2) / SHARPEST) <= value <= true + 1e-9
    n, d, p = np.cumsum(sizes)
    assert (multipliers >= 0).all()
    assert multipliers[:n].sum() == pytest.approx(1.0)
    assert multipliers[n:d].sum() == pytest.approx(1.0)
    assert multipliers[d:p].sum() == pytest.approx(multipliers[p:].sum(), abs=1e-9)


@few
@given(seeds, actuator_counts)
def test_one_ratio_is_climbed_to_its_greatest_eigenvalue(seed: int, actuators: int) -> None:
    problem = random_problem(seed, actuators, (1, 1, 1))
    numerator, denominator, level = first_forms(problem)
    drive, multipliers = random_drive(seed, actuators), np.empty(3 + actuators)
    usable = np.ones(actuators, dtype=bool)
    value = climb(drive, usable, numerator, denominator, level, ANYTHING, 30.0, SHARPEST, multipliers, PENALTY)
    assert value == pytest.approx(np.log(eigh(numerator[0], denominator[0], eigvals_only=True)[-1]), abs=1e-4)


@few
@given(seeds, st.integers(2, 4), counts)
def test_a_climb_ends_no_lower_than_it_began_and_leaves_silent_actuators_silent(
    seed: int, actuators: int, sizes: tuple[int, int, int]
) -> None:
    problem = random_problem(seed, actuators, sizes)
    numerator, denominator, level = first_forms(problem)
    drive, usable = random_drive(seed, actuators), np.ones(actuators, dtype=bool)
    usable[-1], drive[-1] = False, 0
    gradient, (multipliers, logs) = np.empty(2 * actuators), np.empty((2, sum(sizes) + actuators))
    before = evaluate(drive, usable, numerator, denominator, level, 0.0, SHARPEST, gradient, multipliers, logs, PENALTY)
    after = climb(drive, usable, numerator, denominator, level, 0.0, SHARPEST, SHARPEST, multipliers, PENALTY)
    assert after >= before - 1e-9
    assert drive[-1] == 0


@few
@given(seeds, st.integers(4, 9))
def test_interpolation_is_exact_for_cubics_and_at_the_grid(seed: int, frequencies: int) -> None:
    random = np.random.default_rng(seed)
    grid_hz = np.sort(random.uniform(60, 300, frequencies))
    grid_hz += np.arange(frequencies)  # apart
    factors = random_forms(random, 4, 1, 2)
    tone, out = np.zeros(2, dtype=np.int64), np.empty((1, 2, 2), dtype=np.complex128)

    def cubic(hz: Array) -> Complex:
        x = (hz - 180) / 120
        forms: Complex = np.einsum("kab,fk->fab", factors[:, 0], x[:, None] ** np.arange(4))[None]
        return forms

    for hz in [*grid_hz, *random.uniform(grid_hz[0], grid_hz[-1], 5)]:
        interpolate(cubic(grid_hz), grid_hz, np.array([hz]), tone, out)
        assert abs(out - cubic(np.array([hz]))[:, 0]).max() <= 1e-8 * abs(factors).max()


@few
@given(seeds, actuator_counts, counts)
def test_climbing_at_each_frequency_is_climbing_there_alone(
    seed: int, actuators: int, sizes: tuple[int, int, int]
) -> None:
    problem = random_problem(seed, actuators, sizes)
    drives = np.array([random_drive(seed + f, actuators) for f in range(len(problem.frequency_hz))])
    together, value = drives.copy(), np.empty(len(drives))
    usable = np.ones(drives.shape, dtype=bool)
    climb_each(together, usable, *problem.stacks, ANYTHING, 30.0, 300.0, value)
    numerator, denominator, level = first_forms(problem)
    alone, multipliers = drives[0].copy(), np.empty(sum(sizes) + actuators)
    assert (
        climb(alone, usable[0], numerator, denominator, level, ANYTHING, 30.0, 300.0, multipliers, PENALTY) == value[0]
    )
    assert (alone == together[0]).all()


def test_between_fewer_than_four_frequencies_it_takes_what_there_is() -> None:
    tone, out = np.zeros(1, dtype=np.int64), np.empty((1, 1, 1), dtype=np.complex128)
    stack = np.array([3.0, 5.0], dtype=np.complex128).reshape(1, 2, 1, 1)
    interpolate(stack, np.array([100.0, 102.0]), np.array([101.0]), tone, out)
    assert out[0, 0, 0] == pytest.approx(4.0)
    interpolate(stack[:, :1].copy(), np.array([100.0]), np.array([100.0]), tone, out)
    assert out[0, 0, 0] == pytest.approx(3.0)


def test_actuators_on_different_tones_do_not_interfere() -> None:
    stack = random_forms(np.random.default_rng(3), 2, 6, 3)
    grid_hz, out = 60 + 10.0 * np.arange(6), np.empty((2, 3, 3), dtype=np.complex128)
    interpolate(stack, grid_hz, np.array([70.0, 100.0]), np.array([0, 1, 0]), out)
    assert out[:, [0, 2]][:, :, [0, 2]] == pytest.approx(stack[:, 1][:, [0, 2]][:, :, [0, 2]])
    assert out[:, 1, 1] == pytest.approx(stack[:, 4, 1, 1])
    assert not out[:, 1, [0, 2]].any() and not out[:, [0, 2], 1].any()


def test_refining_ends_at_the_frequencies_where_the_ratio_is_greatest() -> None:
    """Each tone's power is a parabola over frequency with its peak off the grid; the weaker tone counts."""
    grid_hz, peaks_hz = 100 + 2.0 * np.arange(41), np.array([113.37, 161.11])
    bumps = 1.5 - ((grid_hz[:, None] - peaks_hz) / 60) ** 2
    unit = np.eye(2, dtype=np.complex128)
    numerator = np.stack([bumps[:, t, None, None] * np.diag(unit[t]) for t in (0, 1)])
    denominator = np.broadcast_to(unit, (1, len(grid_hz), 2, 2)).copy()
    drives, hz = np.array([[1.0, 0.2j]]), np.array([[110.0, 164.0]])
    low, high, multipliers = hz - 5, hz + 5, np.empty((1, 7))
    usable, tone = np.ones((1, 2), dtype=bool), np.array([[0, 1]])
    refine(drives, usable, numerator, denominator, numerator, grid_hz, hz, tone, low, high, ANYTHING, 1e-3, multipliers)
    assert hz[0] == pytest.approx(peaks_hz, abs=2e-3)
    assert abs(drives[0, 0]) == pytest.approx(abs(drives[0, 1]), rel=1e-3)
