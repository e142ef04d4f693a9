"""Laws of the program: the optimum of the whole, exactly within its limits, below its bound, homogeneous."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import linprog

from precompute.clicks import program as program_module
from precompute.clicks.basis import EVALUATIONS_PER_SAMPLE, drive_rows, make_tones, orthogonalised
from precompute.clicks.options import DEFAULT_OPTIONS
from precompute.clicks.program import TOLERANCE
from precompute.clicks.simplex import Outcome
from tests.precompute.clicks.click_cases import fresh_responses, placed
from tests.precompute.clicks.dense_rows import program_of
from tests.precompute.devices import shipped

Array = NDArray[np.float64]
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
def test_it_is_the_optimum_of_the_whole_program(seed: int, aims: int) -> None:
    kept, watched, goals = problem(seed, aims)
    found, expected = program_of(kept, watched, aims).maximise(goals), whole(kept, watched, goals)
    assert found.value == pytest.approx(expected, rel=2 * TOLERANCE)
    assert found.value <= expected * (1 + 2e-5) and expected <= found.bound.at(1.0) * (1 + 1e-9)
    assert found.value == pytest.approx((goals @ found.weight).min())


@seeds
@aims_of
def test_an_earlier_optimum_is_found_again_from_its_basis(seed: int, aims: int) -> None:
    kept, watched, goals = problem(seed, aims)
    program = program_of(kept, watched, aims)
    first = program.maximise(goals)
    for other in range(20):  # rows of the first are deleted meanwhile
        program.maximise(problem(100 + other, aims)[2])
    before = program.effort.pivots
    again = program.maximise(goals, start=first.basis)
    assert again.value == pytest.approx(first.value, rel=1e-6) and program.effort.pivots - before <= 1


@seeds
@aims_of
def test_watched_courses_may_reach_the_limit_and_what_was_solved_before_does_not_matter(seed: int, aims: int) -> None:
    kept, watched, goals = problem(seed, aims)
    program = program_of(kept, watched, aims)
    for other in range(3):
        program.maximise(problem(100 + other, aims)[2])
    for limit in (0.3, 1.0):
        program.set_limit(limit)
        found = program.maximise(goals)
        assert found.value == pytest.approx(whole(kept, watched, goals, limit), rel=2 * TOLERANCE)
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


def test_many_aims_one_after_another_do_not_fill_the_program() -> None:
    """Rows that press no longer go; what they leave is solved like the first."""
    random = np.random.default_rng(7)
    kept, watched = random.normal(size=(60, 20)), 0.4 * random.normal(size=(40, 300, 20))
    program, aims = program_of(kept, watched, 1), random.normal(size=(12, 1, 20))
    values = [program.maximise(aim).value for aim in aims]
    assert program.maximise(aims[0]).value == pytest.approx(values[0], rel=2 * TOLERANCE)
    assert program.rows < 0.1 * watched[..., 0].size


def test_without_watched_courses_only_the_kept_rows_count() -> None:
    kept, _, goals = problem(1, 1)
    found = program_of(kept, np.zeros((0, 60, 8)), 1).maximise(goals)
    assert found.value == pytest.approx(whole(kept, np.zeros((0, 60, 8)), goals), rel=TOLERANCE)


@pytest.mark.parametrize("letters", ["F--q-", "qF-Fq", "q--qF"])
def test_highs_finds_the_same_optimum_of_a_click_s_program(letters: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Values within the tolerance of both, and each below the bound that the other proves."""
    device = shipped("reference-a")
    placement, tones = placed(device, letters), orthogonalised(make_tones(device, DEFAULT_OPTIONS.length_s))
    played = fresh_responses(device.name, placement, 6).play_each(tones)[:, :, ::EVALUATIONS_PER_SAMPLE]
    watched = played[:, placement.quiet].reshape(-1, *played.shape[2:])
    drive, course = drive_rows(tones, device.limits.amplitude), played[:, placement.felt].mean(axis=0)
    ours, highs = (program_of(drive, watched, len(placement.felt)) for _ in range(2))
    for instant, limit in ((60, 1.0), (75, 1.0), (60, 0.7)):
        ours.set_limit(limit)
        highs.set_limit(limit)
        own = ours.maximise(course[:, instant])
        with monkeypatch.context() as patch:
            patch.setattr(program_module, "maximise", lambda *_: (Outcome.FAILED, 0))
            other = highs.maximise(course[:, instant])
        assert own.value == pytest.approx(other.value, rel=2 * TOLERANCE)
        assert other.bound.at(limit) == pytest.approx(own.bound.at(limit), rel=2 * TOLERANCE)
        assert own.value <= other.bound.at(limit) * (1 + 2e-5)
        assert other.value <= own.bound.at(limit) * (1 + 2e-5)
    assert highs.effort.fallbacks > 0 == ours.effort.fallbacks
