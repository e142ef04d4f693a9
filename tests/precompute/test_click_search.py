"""Laws of the search: no instant and no choice of signs that could be tried does better than the bound says."""

import numpy as np
import pytest
from numpy.typing import NDArray

from precompute.click_basis import LOOK_RATE_HZ
from precompute.click_program import Program
from precompute.click_search import AFTER_S, NEGLIGIBLE, STEP_S, Aim, Strongest, search_click

Array = NDArray[np.float64]
LENGTH_S = 0.02
INSTANTS = np.arange(LENGTH_S / 2, LENGTH_S + AFTER_S, STEP_S) * LOOK_RATE_HZ
cases = pytest.mark.parametrize(("seed", "fingers"), [(0, 1), (1, 1), (2, 2), (3, 2), (4, 3)])


def problem(seed: int, fingers: int) -> tuple[Array, Array, Array]:
    """Kept rows, watched courses and the felt fingers' courses of twelve tones, all at random."""
    random = np.random.default_rng(seed)
    watched, course = (0.3 * random.normal(size=(count, 240, 12)) for count in (4, fingers))
    return random.normal(size=(40, 12)), watched, course


def found(seed: int, fingers: int) -> tuple[Strongest, Array]:
    kept, watched, course = problem(seed, fingers)
    return search_click(Program(kept, watched, fingers), course, LENGTH_S), course


@cases
def test_no_common_instant_does_better_than_the_bound(seed: int, fingers: int) -> None:
    strongest, _ = found(seed, fingers)
    kept, watched, course = problem(seed, fingers)
    for instant in np.round(INSTANTS).astype(int).tolist():
        for signs in np.ndindex(*[2] * (fingers - 1)):
            aim = Aim(np.full(fingers, instant), np.array([1.0, *(1 - 2.0 * np.array(signs))]))
            value = Program(kept, watched, fingers).maximise(aim.rows(course)).value
            assert value <= strongest.bound * (1 + 1e-6)
    assert strongest.bound <= strongest.optimum.value * (1 + 2 * NEGLIGIBLE)


@cases
def test_its_value_is_what_the_weakest_finger_feels_at_its_instant(seed: int, fingers: int) -> None:
    strongest, course = found(seed, fingers)
    felt = course @ strongest.optimum.weight
    at = felt[np.arange(fingers), strongest.aim.instant] * strongest.aim.sign
    assert at.min() == pytest.approx(strongest.optimum.value)
    assert abs(felt).max(axis=1).min() <= strongest.optimum.value * 1.05


def test_limits_twice_as_wide_give_twice_as_much() -> None:
    one, _ = found(0, 1)
    two = one.scaled(2.0)
    assert (two.optimum.value, two.bound) == pytest.approx((2 * one.optimum.value, 2 * one.bound))
    assert two.optimum.weight == pytest.approx(2 * one.optimum.weight)
