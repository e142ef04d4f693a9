"""A short run of the damaged frames; `python -m tests.firmware_link.corrupt 10000000` is the long one."""

from collections import Counter

import pytest

from firmware_link.protocol.framing import FrameDecoder
from tests.firmware_link.corrupt import ACTUATORS, DAMAGES, Chance, Damage, count_outcomes, make_batch

FRAMES = 3_000


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda damage: damage.__name__)
def test_no_damaged_frame_is_accepted_and_the_next_one_always_is(damage: Damage) -> None:
    batch, decoder = make_batch(damage, FRAMES, Chance(5)), FrameDecoder(ACTUATORS)
    outcomes = count_outcomes(batch, decoder.receive(batch.stream))
    # Doubling a byte or the like may leave the frame as it was.
    assert outcomes["refused"] > 0.85 * FRAMES
    assert decoder.counters.ok == outcomes["refused"] + 2 * outcomes["what was sent"]


def test_the_count_finds_a_frame_that_was_not_sent() -> None:
    batch = make_batch(DAMAGES[0], 10, Chance(5))
    assert count_outcomes(batch, [*batch.whole]) == Counter(refused=10)
    forged = [*batch.whole[:5], b"\x07\x01", *batch.whole[5:]]
    with pytest.raises(AssertionError):
        count_outcomes(batch, forged)
    with pytest.raises(AssertionError):
        count_outcomes(batch, batch.whole[:-1])
