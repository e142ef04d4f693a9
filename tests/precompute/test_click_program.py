"""Laws of the program: the optimum of the whole, exactly within its limits, below its bound, homogeneous."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import linprog

from precompute.click_program import TOLERANCE, Program

Array = NDArray[np.float64]
seeds = pytest.mark.parametrize("seed", range(6))
aims_of = pytest.mark.parametrize("aims", [1, 2, 3])


def problem(seed: int, aims: int) -> tuple[Array, Array, Array]:
    """Kept rows (row, tone), watched courses (course, time, tone) that hold, and aims."""
    random = np.random.default_rng(seed)
    return random.normal(size=(30, 8)), 0.3 * random.normal(size=(5, 60, 8)), random.normal(size=(aims, 8))


def whole(kept: Array, watched: Array, aims: Array, room: float = 1.0) -> float:
    """The same program with all its rows at once, by SciPy."""
    rows, tones = np.concatenate([kept / room, watched.reshape(-1, kept.shape[1])]), kept.shape[1]
    limits = np.concatenate([np.column_stack([s * rows, np.zeros(len(rows))]) for s in (1, -1)])
    goals = np.column_stack([-aims, np.ones(len(aims))])
    right = np.concatenate([np.ones(len(limits)), np.zeros(len(aims))])
    cost = np.append(np.zeros(tones), -1.0)
    return -float(linprog(cost, np.concatenate([limits, goals]), right, bounds=(None, None)).fun or np.nan)


@seeds
@aims_of
def test_it_is_the_optimum_of_the_whole_program(seed: int, aims: int) -> None:
    kept, watched, goals = problem(seed, aims)
    found, expected = Program(kept, watched, aims).maximise(goals), whole(kept, watched, goals)
    assert found.value == pytest.approx(expected, rel=2 * TOLERANCE)
    assert found.value <= expected * (1 + 1e-9) and expected <= found.bound * (1 + 1e-9)
    assert found.value == pytest.approx((goals @ found.weight).min())


@seeds
@aims_of
def test_no_limit_is_violated(seed: int, aims: int) -> None:
    kept, watched, goals = problem(seed, aims)
    weight = Program(kept, watched, aims).maximise(goals).weight
    assert abs(kept @ weight).max() <= 1 + 1e-9 and abs(watched @ weight).max() <= 1 + 1e-9


@seeds
@aims_of
def test_what_was_solved_before_does_not_matter(seed: int, aims: int) -> None:
    kept, watched, goals = problem(seed, aims)
    program = Program(kept, watched, aims)
    for other in range(3):
        program.maximise(problem(100 + other, aims)[2])
    program.set_room(0.4)
    program.maximise(goals)
    program.set_room(1.0)
    assert program.maximise(goals).value == pytest.approx(whole(kept, watched, goals), rel=2 * TOLERANCE)


@seeds
def test_room_is_what_the_kept_rows_may_reach(seed: int) -> None:
    kept, watched, goals = problem(seed, 1)
    program = Program(kept, watched, 1)
    program.set_room(0.3)
    found = program.maximise(goals)
    assert found.value == pytest.approx(whole(kept, watched, goals, 0.3), rel=2 * TOLERANCE)
    assert abs(kept @ found.weight).max() <= 0.3 * (1 + 1e-9)


@seeds
def test_bounds_hold_before_anything_is_solved(seed: int) -> None:
    kept, watched, goals = problem(seed, 1)
    assert Program(kept, watched, 1).bound(goals) >= whole(kept, watched, goals) * (1 - 1e-9)


def test_a_search_below_its_floor_is_given_up_with_a_bound() -> None:
    kept, watched, goals = problem(0, 1)
    best = whole(kept, watched, goals)
    given_up = Program(kept, watched, 1).maximise(goals, floor=1.05 * best)
    assert best * (1 - 1e-9) <= given_up.bound <= 1.05 * best


def test_without_watched_courses_only_the_kept_rows_count() -> None:
    kept, _, goals = problem(1, 1)
    found = Program(kept, np.zeros((0, 60, 8)), 1).maximise(goals)
    assert found.value == pytest.approx(whole(kept, np.zeros((0, 60, 8)), goals), rel=TOLERANCE)
