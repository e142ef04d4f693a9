"""What was lately, in memory that does not grow."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tactable.page.past import Past

KEPT = 7


@given(st.lists(st.integers(0, 3 * KEPT), max_size=30))
def test_the_newest_samples_are_there_in_order_after_zeros(lengths: list[int]) -> None:
    past, everything = Past(KEPT, 2), np.zeros((KEPT, 2))
    for length in lengths:
        samples = np.arange(len(everything), len(everything) + length)[:, None] * np.array([1.0, -1.0])
        past.push(samples)
        everything = np.concatenate([everything, samples])
        assert past.last(KEPT).tolist() == everything[-KEPT:].tolist()
        assert past.last(2).tolist() == everything[-2:].tolist()


def test_a_column_is_forgotten_alone() -> None:
    past = Past(KEPT, 2)
    past.push(np.ones((3, 2)))
    past.forget(1)
    assert past.last(3).tolist() == [[1.0, 0.0]] * 3
