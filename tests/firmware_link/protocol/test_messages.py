"""Laws of the messages: round trips, exact lengths, nothing wraps."""

import dataclasses
import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import firmware_link
from firmware_link.protocol.drive_words import ChannelDrive, decode_drive, encode_drive
from firmware_link.protocol.framing import encode_frame, encode_message
from firmware_link.protocol.layout import Layout, Message
from firmware_link.protocol.link_errors import MessageError
from firmware_link.protocol.messages import (
    MAGIC,
    MESSAGES,
    HelloRequest,
    Set,
    SetFlag,
    Stop,
    decode_body,
    encode_body,
    encode_set_body,
    has_exact_length,
    seed_of,
)
from tests.firmware_link.codegen.protocol_table import protocol_table
from tests.firmware_link.codegen.vectors import example_basis, example_plays
from tests.firmware_link.strategies import BITS, RESOLUTION_HZ, channel_drives, messages, sequences, unhurried

PROTOCOL = (Path(firmware_link.__file__).parent / "PROTOCOL.md").read_text(encoding="utf-8")


@unhurried
@given(st.data(), st.integers(1, 5), sequences)
def test_body_round_trip(data: st.DataObject, number_of_actuators: int, sequence: int) -> None:
    message = data.draw(messages(number_of_actuators))
    body = encode_body(message, sequence)
    assert decode_body(body) == (sequence, message)
    assert has_exact_length(body, number_of_actuators)
    assert not has_exact_length(body[:-1], number_of_actuators)
    assert not has_exact_length(body + b"\0", number_of_actuators)


@unhurried
@given(messages(2), sequences)
def test_values_that_do_not_fit_are_refused(message: Message, sequence: int) -> None:
    for name, word in Layout(type(message)).words:
        values = (-1, 2 ** BITS[word.kind]) if word.block_size is None else (b"", bytes(word.block_size + 1))
        for value in values:
            with pytest.raises(MessageError):
                encode_body(dataclasses.replace(message, **{name: value}), sequence)
    with pytest.raises(MessageError):
        encode_body(message, 256)


def test_a_meaning_that_is_not_known_is_refused() -> None:
    body = bytearray(encode_body(Set(0, SetFlag.WRITE_PHASE, 40, bytes(12)), 1))
    body[4] = 0x80
    with pytest.raises(MessageError, match="SET"):
        decode_body(bytes(body))


@unhurried
@given(st.lists(channel_drives, max_size=4))
def test_drive_is_the_nearest_that_the_words_can_say_and_its_bytes_survive(channels: list[ChannelDrive]) -> None:
    drive = encode_drive(channels, RESOLUTION_HZ)
    decoded = decode_drive(drive, RESOLUTION_HZ)
    assert encode_drive(decoded, RESOLUTION_HZ) == drive
    for wanted, got in zip(channels, decoded, strict=True):
        assert got.frequency_hz == pytest.approx(wanted.frequency_hz, abs=0.51 * RESOLUTION_HZ)
        assert got.amplitude == pytest.approx(wanted.amplitude, abs=0.51 / 65_535)
        error_rad = math.remainder(got.phase_rad - wanted.phase_rad, math.tau)
        assert abs(error_rad) < 0.51 * math.tau / 65_536


@pytest.mark.parametrize(
    "wrong",
    [
        *({"frequency_hz": value} for value in (655.36, -0.01, math.nan, math.inf)),
        *({"amplitude": value} for value in (1.0001, -0.0001, math.nan)),
        *({"phase_rad": value} for value in (math.inf, math.nan)),
    ],
)
def test_a_drive_out_of_range_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(MessageError):
        encode_drive([dataclasses.replace(ChannelDrive(60.0, 0.5), **wrong)], RESOLUTION_HZ)


def test_types_and_seeds_are_distinct_and_the_fixed_ones_are_zero() -> None:
    assert len({message.type_byte for message in MESSAGES}) == len(MESSAGES)
    fixed = {message.wire_name for message in MESSAGES if seed_of(message.type_byte) == 0}
    assert fixed == {"HELLO_REQ", "HELLO", "STOP"}
    assert len({seed_of(message.type_byte) for message in MESSAGES}) == len(MESSAGES) - len(fixed) + 1


def test_the_table_and_the_magic_of_the_document_are_the_definition() -> None:
    _, _, rest = PROTOCOL.partition("<!-- made by protocol_table() -->\n")
    table, _, _ = rest.partition("<!-- end -->")
    assert table == protocol_table()
    assert f"The `magic` of HELLO_REQ is 0x{MAGIC:08x}, the bytes `tact` on the wire" in PROTOCOL
    assert encode_body(HelloRequest(MAGIC, 1, 0, 0), 0)[2:6] == b"tact"


def test_the_worked_example_of_the_document_is_true() -> None:
    drive = encode_drive([ChannelDrive(60, 1, 0), ChannelDrive(60, 0.5, math.pi / 2)], RESOLUTION_HZ)
    body = encode_body(Set(1000, SetFlag.WRITE_PHASE, 40, drive), 7)
    basis = example_basis()
    play = encode_message(example_plays()[0], 16)
    assert f"with the hash {basis.hash:x}." in PROTOCOL
    for example in (drive, body, encode_frame(body), encode_message(Stop(), 8), basis.data, play):
        assert f"\n    {example.hex(' ')}\n" in PROTOCOL
    assert len(encode_frame(body)) == 24


@given(st.integers(0, 65_535), st.integers(0, 100), st.binary(min_size=12, max_size=12), sequences)
def test_the_quick_way_to_a_set_is_the_other_way(reference: int, lease_ms: int, drive: bytes, sequence: int) -> None:
    message = Set(reference, SetFlag.WRITE_PHASE, lease_ms, drive)
    assert encode_set_body(reference, lease_ms, drive, sequence) == encode_body(message, sequence)
