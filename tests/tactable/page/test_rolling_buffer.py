"""What was lately, in memory that does not grow."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tactable.page.rolling_buffer import RollingBuffer

KEPT = 7


@given(st.lists(st.integers(0, 3 * KEPT), max_size=30))
def test_the_newest_samples_are_there_in_order_after_zeros(lengths: list[int]) -> None:
    kept, everything = RollingBuffer(KEPT, 2), np.zeros((KEPT, 2))
    for length in lengths:
        samples = np.arange(len(everything), len(everything) + length)[:, None] * np.array([1.0, -1.0])
        kept.push(samples)
        everything = np.concatenate([everything, samples])
        assert kept.last(KEPT).tolist() == everything[-KEPT:].tolist()
        assert kept.last(2).tolist() == everything[-2:].tolist()
