"""Laws of the search: no instant and no choice of signs that could be tried does better than the bound says."""

import numpy as np
import pytest

from base.arrays import Array
from precompute.clicks.click_basis import EVALUATION_RATE_HZ
from tests.precompute.clicks.judge.dense_rows import program_of
from tests.precompute.clicks.judge.instants import AFTER_S, STEP_S, Aim, Search

GAIN = 1e-2
LENGTH_S = 0.02
INSTANTS = np.arange(LENGTH_S / 2, LENGTH_S + AFTER_S, STEP_S) * EVALUATION_RATE_HZ


def problem(seed: int, fingers: int) -> tuple[Array, Array, Array]:
    """Kept rows, watched courses and the felt fingers' courses of twelve tones, all at random."""
    random = np.random.default_rng(seed)
    watched, course = (0.3 * random.normal(size=(count, 240, 12)) for count in (4, fingers))
    return random.normal(size=(40, 12)), watched, course


@pytest.mark.parametrize(("seed", "fingers"), [(0, 1), (1, 1), (2, 2), (3, 2), (4, 3)])
@pytest.mark.parametrize("limit", [1.0, 0.6])
def test_its_value_is_felt_and_no_common_instant_does_better_than_the_bound(
    seed: int, fingers: int, limit: float
) -> None:
    """Nor under another limit than the one before."""
    kept, watched, course = problem(seed, fingers)
    searched = Search(program_of(kept, watched, fingers), course, LENGTH_S, GAIN)
    searched.strongest(1.0)
    strongest, bound = searched.strongest(limit), searched.bound(limit)
    felt = course @ strongest.optimum.weight
    at = felt[np.arange(fingers), strongest.aim.instant] * strongest.aim.sign
    assert at.min() == pytest.approx(strongest.optimum.value)
    assert abs(felt).max(axis=1).min() <= strongest.optimum.value * 1.05
    program = program_of(kept, watched, fingers)
    program.set_limit(limit)
    for instant in np.round(INSTANTS).astype(int).tolist():
        for signs in np.ndindex(*[2] * (fingers - 1)):
            aim = Aim(np.full(fingers, instant), np.array([1.0, *(1 - 2.0 * np.array(signs))]))
            assert program.maximise(aim.rows(course)).value <= bound * (1 + 1e-6)
    assert bound <= strongest.optimum.value * (1 + 2 * GAIN)
