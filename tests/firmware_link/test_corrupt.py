"""The count of what became of damaged frames finds those that were not sent, and those that were lost."""

from collections import Counter

import pytest

from tests.firmware_link.corrupt import DAMAGES, Chance, count_outcomes, make_batch


def test_the_count_finds_a_frame_that_was_not_sent() -> None:
    batch = make_batch(DAMAGES[0], 10, Chance(5))
    assert count_outcomes(batch, [*batch.whole]) == Counter(refused=10)
    forged = [*batch.whole[:5], b"\x07\x01", *batch.whole[5:]]
    with pytest.raises(AssertionError):
        count_outcomes(batch, forged)
    with pytest.raises(AssertionError):
        count_outcomes(batch, batch.whole[:-1])
