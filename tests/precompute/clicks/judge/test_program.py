"""Laws of the program: the optimum of the whole, exactly within its limits, below its bound, homogeneous."""

import numpy as np
import pytest
from scipy.optimize import linprog

from base.arrays import Array
from tests.precompute.clicks.judge.dense_rows import program_of
from tests.precompute.clicks.judge.program import TOLERANCE

seeds = pytest.mark.parametrize("seed", range(6))
aims_of = pytest.mark.parametrize("aims", [1, 2, 3])


def problem(seed: int, aims: int) -> tuple[Array, Array, Array]:
    """Kept rows (row, tone), watched courses (course, time, tone) that hold, and aims."""
    random = np.random.default_rng(seed)
    return random.normal(size=(30, 8)), 0.3 * random.normal(size=(5, 60, 8)), random.normal(size=(aims, 8))


def whole(kept: Array, watched: Array, aims: Array, limit: float = 1.0) -> float:
    """The same program with all its rows at once, by SciPy."""
    rows, tones = np.concatenate([kept, watched.reshape(-1, kept.shape[1]) / limit]), kept.shape[1]
    limits = np.concatenate([np.column_stack([s * rows, np.zeros(len(rows))]) for s in (1, -1)])
    goals = np.column_stack([-aims, np.ones(len(aims))])
    right = np.concatenate([np.ones(len(limits)), np.zeros(len(aims))])
    cost = np.append(np.zeros(tones), -1.0)
    return -float(linprog(cost, np.concatenate([limits, goals]), right, bounds=(None, None)).fun or np.nan)


@seeds
@aims_of
def test_it_is_the_optimum_of_the_whole_program_whatever_was_solved_before(seed: int, aims: int) -> None:
    kept, watched, goals = problem(seed, aims)
    program = program_of(kept, watched, aims)
    for other in range(3):
        program.maximise(problem(100 + other, aims)[2])
    for limit in (0.3, 1.0):
        program.set_limit(limit)
        found = program.maximise(goals)
        expected = whole(kept, watched, goals, limit)
        assert found.value == pytest.approx(expected, rel=2 * TOLERANCE)
        assert found.value == pytest.approx((goals @ found.weight).min())
        assert found.value <= expected * (1 + 2e-5) and expected <= found.bound.at(limit) * (1 + 1e-9)
        assert abs(watched @ found.weight).max() <= limit * (1 + 2e-5) and abs(kept @ found.weight).max() <= 1 + 1e-9


@seeds
@aims_of
@pytest.mark.parametrize("limit", [0.2, 0.7, 1.5, 4.0])
def test_a_bound_holds_at_every_other_limit(seed: int, aims: int, limit: float) -> None:
    kept, watched, goals = problem(seed, aims)
    bound = program_of(kept, watched, aims).maximise(goals).bound
    assert bound.at(limit) >= whole(kept, watched, goals, limit) * (1 - 1e-9)
    assert bound.at(1.0) == pytest.approx(whole(kept, watched, goals), rel=2 * TOLERANCE)


def test_a_search_below_its_floor_is_given_up_with_a_bound() -> None:
    kept, watched, goals = problem(0, 1)
    best = whole(kept, watched, goals)
    given_up = program_of(kept, watched, 1).maximise(goals, floor=1.05 * best)
    assert best * (1 - 1e-9) <= given_up.bound.at(1.0) <= 1.05 * best


def test_without_watched_courses_only_the_kept_rows_count() -> None:
    kept, _, goals = problem(1, 1)
    found = program_of(kept, np.zeros((0, 60, 8)), 1).maximise(goals)
    assert found.value == pytest.approx(whole(kept, np.zeros((0, 60, 8)), goals), rel=TOLERANCE)
