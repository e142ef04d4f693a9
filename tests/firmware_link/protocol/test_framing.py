"""Laws of the frames: what was not sent is not accepted, and the next delimiter sets all right."""

import itertools

from cobs import cobs
from hypothesis import example, given
from hypothesis import strategies as st

from firmware_link.protocol.framing import (
    EMERGENCY_STOP,
    FrameDecoder,
    FrameEncoder,
    Signal,
    encode_frame,
    encode_message,
    longest_stuffed_length,
)
from firmware_link.protocol.messages import MAXIMUM_ACTUATORS, KeepAlive, encode_body, longest_body_length
from tests.firmware_link.strategies import messages, sequences, unhurried

ACTUATORS = 2
bodies = st.builds(encode_body, messages(ACTUATORS), sequences)


def decode(data: bytes) -> list[bytes | Signal]:
    return FrameDecoder(ACTUATORS).receive(data)


@unhurried
@given(st.lists(bodies, max_size=5), st.lists(st.integers(0, 300)))
def test_frames_survive_any_chunking(sent: list[bytes], cuts: list[int]) -> None:
    stream = b"".join(encode_frame(body) for body in sent)
    edges = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    decoder = FrameDecoder(ACTUATORS)
    received = [item for start, stop in itertools.pairwise(edges) for item in decoder.receive(stream[start:stop])]
    assert received == sent
    assert decoder.counters.ok == len(sent)


@unhurried
@given(bodies)
def test_wire_bytes_are_the_body_and_six(body: bytes) -> None:
    frame = encode_frame(body)
    assert len(frame) == len(body) + 6
    assert frame.index(0) == len(frame) - 1


@unhurried
@given(bodies)
def test_no_bit_flip_is_accepted(body: bytes) -> None:
    frame = encode_frame(body)
    for bit in range(8 * len(frame)):
        damaged = bytearray(frame)
        damaged[bit // 8] ^= 1 << bit % 8
        assert decode(bytes(damaged)) == []


@unhurried
@given(st.binary(max_size=600), bodies)
def test_any_garbage_ends_at_the_next_delimiter(garbage: bytes, body: bytes) -> None:
    assert decode(garbage + b"\0" + encode_frame(body))[-1:] == [body]


def test_the_longest_frame_has_room_whatever_its_bytes_are() -> None:
    for actuators in range(1, MAXIMUM_ACTUATORS + 1):
        body = b"\1" * longest_body_length(actuators)  # a byte is added where none is 0
        room = longest_stuffed_length(actuators) - (len(encode_frame(body)) - 1)
        assert room in (0, 1), actuators


def test_overflow_is_counted_once_and_discarded() -> None:
    decoder = FrameDecoder(ACTUATORS)
    frame = encode_message(KeepAlive(7, 0), 1)
    for _ in range(100):
        assert decoder.receive(b"\x55" * 100) == []
    assert decoder.receive(frame) == []
    assert decoder.receive(frame) == [encode_body(KeepAlive(7, 0), 1)]
    assert (decoder.counters.overrun, decoder.counters.ok) == (1, 1)


@unhurried
@example(b"", 7, 1)
@example(b"", 8, 1)
@given(st.sampled_from([b"", b"\x55"]), st.integers(0, 20), st.integers(1, 20))
def test_eight_delimiters_in_a_row_are_one_emergency_stop(before: bytes, delimiters: int, chunk: int) -> None:
    decoder = FrameDecoder(ACTUATORS)
    stream = before + bytes(delimiters)
    received = [item for at in range(0, len(stream), chunk) for item in decoder.receive(stream[at : at + chunk])]
    assert received == ([Signal.EMERGENCY_STOP] if delimiters >= len(EMERGENCY_STOP) else [])


def test_a_frame_without_a_body_is_refused() -> None:
    decoder = FrameDecoder(ACTUATORS)
    assert decoder.receive(cobs.encode(b"\x06\x01\x02\x03\x04") + b"\0") == []
    assert (decoder.counters.length, decoder.counters.crc) == (1, 0)


def test_a_sender_numbers_its_messages_from_one_on_and_leaves_none_out() -> None:
    encoder = FrameEncoder()
    assert [encoder.next_sequence() for _ in range(258)] == [*range(1, 256), 0, 1, 2]
    encoder.encode(KeepAlive(0, 0))
    assert encoder.sequence == 3
