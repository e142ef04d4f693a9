"""Laws of the search: no instant and no choice of signs that could be tried does better than the bound says."""

import numpy as np
import pytest
from numpy.typing import NDArray

from precompute.clicks.basis import EVALUATION_RATE_HZ
from precompute.clicks.program import TOLERANCE
from precompute.clicks.search import AFTER_S, STEP_S, Aim, Found, Search
from tests.precompute.clicks.dense_rows import program_of

Array = NDArray[np.float64]
GAIN = 1e-2
LENGTH_S = 0.02
INSTANTS = np.arange(LENGTH_S / 2, LENGTH_S + AFTER_S, STEP_S) * EVALUATION_RATE_HZ
cases = pytest.mark.parametrize(("seed", "fingers"), [(0, 1), (1, 1), (2, 2), (3, 2), (4, 3)])


def problem(seed: int, fingers: int) -> tuple[Array, Array, Array]:
    """Kept rows, watched courses and the felt fingers' courses of twelve tones, all at random."""
    random = np.random.default_rng(seed)
    watched, course = (0.3 * random.normal(size=(count, 240, 12)) for count in (4, fingers))
    return random.normal(size=(40, 12)), watched, course


def search(seed: int, fingers: int) -> tuple[Search, Array]:
    kept, watched, course = problem(seed, fingers)
    return Search(program_of(kept, watched, fingers), course, LENGTH_S, GAIN), course


def found(seed: int, fingers: int) -> tuple[Found, Array]:
    searched, course = search(seed, fingers)
    return searched.strongest(1.0), course


@cases
@pytest.mark.parametrize("limit", [1.0, 0.6])
def test_no_common_instant_does_better_than_the_bound(seed: int, fingers: int, limit: float) -> None:
    """Nor under another limit than the one before."""
    searched, course = search(seed, fingers)
    searched.strongest(1.0)
    strongest, bound = searched.strongest(limit), searched.bound(limit)
    kept, watched, _ = problem(seed, fingers)
    program = program_of(kept, watched, fingers)
    program.set_limit(limit)
    for instant in np.round(INSTANTS).astype(int).tolist():
        for signs in np.ndindex(*[2] * (fingers - 1)):
            aim = Aim(np.full(fingers, instant), np.array([1.0, *(1 - 2.0 * np.array(signs))]))
            assert program.maximise(aim.rows(course)).value <= bound * (1 + 1e-6)
    assert bound <= strongest.optimum.value * (1 + 2 * GAIN)


@cases
def test_its_value_is_what_the_weakest_finger_feels_at_its_instant(seed: int, fingers: int) -> None:
    strongest, course = found(seed, fingers)
    felt = course @ strongest.optimum.weight
    at = felt[np.arange(fingers), strongest.aim.instant] * strongest.aim.sign
    assert at.min() == pytest.approx(strongest.optimum.value)
    assert abs(felt).max(axis=1).min() <= strongest.optimum.value * 1.05


@cases
def test_an_aim_is_improved_at_any_limit(seed: int, fingers: int) -> None:
    searched, course = search(seed, fingers)
    strongest = searched.strongest(1.0)
    kept, watched, _ = problem(seed, fingers)
    program = program_of(kept, watched, fingers)
    program.set_limit(0.8)
    expected = program.maximise(strongest.aim.rows(course)).value
    assert searched.improve(strongest.aim, 0.8).value == pytest.approx(expected, rel=2 * TOLERANCE)
