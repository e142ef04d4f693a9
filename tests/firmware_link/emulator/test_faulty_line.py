"""Laws of the faulty line: seeded, in order, each fault counted, nothing lost without a count."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_link.emulator.fault_plan import parse_fault_plan
from firmware_link.emulator.faulty_line import FaultyLine, LineCounters
from firmware_link.protocol.framing import FrameDecoder, encode_message
from firmware_link.protocol.messages import KeepAlive
from tests.firmware_link.strategies import unhurried

SECOND_US = 1_000_000


def frames(number: int) -> list[bytes]:
    return [encode_message(KeepAlive(index % 65_536, index % 256), index % 256) for index in range(number)]


def line_of(text: str, seed: str = "1", *, can_be_half_open: bool = False) -> FaultyLine:
    return FaultyLine(parse_fault_plan(text), seed, can_be_half_open=can_be_half_open)


def carry(line: FaultyLine, data: list[bytes], step_us: int = 100) -> bytes:
    """Push one a step; all that arrives in the end."""
    arrived = b""
    for index, part in enumerate(data):
        line.push(part, index * step_us)
        arrived += line.pop(index * step_us)
    while (next_us := line.next_us()) is not None:
        arrived += line.pop(next_us)
    return arrived


def lost(counters: LineCounters) -> int:
    return counters.dropped + counters.unheard + counters.lost


@unhurried
@given(st.lists(st.binary(max_size=30), max_size=10))
def test_a_line_without_faults_carries_all_that_is_ended_by_a_delimiter(parts: list[bytes]) -> None:
    sent = b"".join(parts) + b"\0"
    assert carry(line_of(""), [*parts, b"\0"]) == sent
    assert len(carry(line_of(""), [b"\x55" * 5000])) == 5000, "they are not kept for ever"


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("drop=0.1", "dropped"),
        ("duplicate=0.1", "duplicated"),
        ("bit_errors=1e-3", "flipped_bits"),
        ("insert=0.1", "insertions"),
        ("lose=0.1", "cuts"),
        ("burst=0.1", "bursts"),
    ],
)
def test_faults_come_as_often_as_asked_and_the_receiver_sees_what_was_counted(text: str, kind: str) -> None:
    sent, line, decoder = frames(5000), line_of(text), FrameDecoder(2)
    received = decoder.receive(carry(line, sent))
    counters = line.counters
    expected = 8e-3 * sum(map(len, sent)) if kind == "flipped_bits" else 500
    assert 0.8 * expected < getattr(counters, kind) < 1.2 * expected
    assert counters.frames + counters.duplicated == counters.delivered + lost(counters)
    assert len(received) == decoder.counters.ok == counters.intact
    refused = decoder.counters
    assert refused.crc + refused.framing + refused.length + refused.overrun == counters.damaged


def test_a_slow_line_takes_its_time() -> None:
    line = line_of("baud=9600")
    line.push(b"".join(frames(10)), 0)
    bytes_sent = sum(map(len, frames(10)))
    assert line.pop(bytes_sent * 10 * SECOND_US // 9600 - 2_000) != b""
    assert line.next_us() is not None
    line.pop(bytes_sent * 10 * SECOND_US // 9600 + 20)
    assert line.next_us() is None


def test_a_half_open_line_loses_one_direction_only() -> None:
    for can_be_half_open, heard in ((True, 1000), (False, 2000)):
        line = line_of("half_open=1s@0.5s", can_be_half_open=can_be_half_open)
        carry(line, frames(2000), 1000)
        assert line.counters.delivered == heard
        assert line.counters.unheard == 2000 - heard
