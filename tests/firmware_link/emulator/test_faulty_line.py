"""Laws of the faults: each text is read as it is meant; those of a line come as often as asked, and are counted."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_link.emulator.fault_plan import (
    FaultPlan,
    FaultPlanError,
    TimedFault,
    TimedKind,
    fault_help,
    parse_fault_plan,
)
from firmware_link.emulator.faulty_line import FaultyLine, LineCounters
from firmware_link.protocol.framing import FrameDecoder, encode_message
from firmware_link.protocol.messages import KeepAlive
from tests.firmware_link.strategies import unhurried


@pytest.mark.parametrize("key", fault_help())
def test_the_example_of_each_key_is_understood(key: str) -> None:
    for example in fault_help()[key].split(": ")[1:]:
        assert parse_fault_plan(example.split(", ")[0]) != FaultPlan()


@pytest.mark.parametrize(
    "text",
    [
        *("drop=2", "drop", "drop=nan", "drift=5", "baud=0", "at_noise=1", "reboot=1.2.3s@4s"),
        *("stall=0.3s", "stall@3s", "stall=2s/1s", "hang_up=1@8s"),
    ],
)
def test_a_wrong_text_is_named_with_an_example_of_its_key(text: str) -> None:
    example = fault_help()[re.split("[=@]", text)[0]]
    with pytest.raises(FaultPlanError, match=re.escape(f"'{text}' is not understood; write it as in: {example}")):
        parse_fault_plan(text)


def test_a_key_that_is_unknown_or_given_twice_is_named() -> None:
    remedy = r"\(did you mean 'drop'\?\); there are bit_errors, drop"
    with pytest.raises(FaultPlanError, match=f"'dropp' is unknown {remedy}"):
        parse_fault_plan("dropp=0.1")
    with pytest.raises(FaultPlanError, match="'drop' is given twice"):
        parse_fault_plan("drop=0.1,drop=0.2")


def test_a_fault_comes_once_or_again_and_again() -> None:
    once = TimedFault(TimedKind.STALL, 100, 10, None)
    assert [once.begins_us(0), once.begins_us(100), once.begins_us(101)] == [100, 100, None]
    assert [once.ends_us(99), once.ends_us(100), once.ends_us(109), once.ends_us(110)] == [None, 110, 110, None]
    again = TimedFault(TimedKind.STALL, 100, 10, 100)
    assert [again.begins_us(0), again.begins_us(101), again.begins_us(200)] == [100, 200, 200]
    assert [again.ends_us(50), again.ends_us(205), again.ends_us(211)] == [None, 210, None]


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
