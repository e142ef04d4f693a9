"""Frames of the wire: a body to `COBS(body ‖ crc32_le) ‖ 0x00` and back, and how many of them a line carries."""

import zlib
from dataclasses import dataclass
from enum import Enum

from cobs import cobs

from firmware_link.protocol import messages
from firmware_link.protocol.layout import Message

DELIMITER = b"\0"
EMERGENCY_STOP_RUN = 8
# Needs no parser and no connection: write these bytes and every device disarms.
EMERGENCY_STOP = DELIMITER * EMERGENCY_STOP_RUN

_CHECKSUM_SIZE = 4
_SHORTEST_BODY = 2
NS_PER_S = 1_000_000_000
UART_BITS_PER_BYTE = 10  # a start bit, eight of data, a stop bit
SENSED_SHARE = 0.8  # the rest is for STATUS and answers, and for an accelerometer that is faster than it says


class Signal(Enum):
    """A signal in the stream that is not a frame."""

    EMERGENCY_STOP = "eight delimiters in a row"


@dataclass
class FramingCounters:
    """Frames accepted, and refused by reason, since the decoder was made."""

    ok: int = 0
    crc: int = 0
    framing: int = 0
    length: int = 0
    overrun: int = 0


def encode_frame(body: bytes) -> bytes:
    """Frame of a body of a known message type."""
    seed = messages.seed_of(body[0])
    if seed is None:
        raise KeyError(f"message type {body[0]:#04x}")
    stuffed: bytes = cobs.encode(body + zlib.crc32(body, seed).to_bytes(_CHECKSUM_SIZE, "little"))
    return stuffed + DELIMITER


def encode_message(message: Message, sequence: int) -> bytes:
    """Frame of a message; raises MessageError for a value that does not fit."""
    return encode_frame(messages.encode_body(message, sequence))


class FrameEncoder:
    """Numbers the messages of one sender, from 1 on and modulo 256, and makes their frames."""

    def __init__(self) -> None:
        self.sequence = 0  # the sequence number of the last frame

    def next_sequence(self) -> int:
        """Take the next number."""
        self.sequence = sequence = (self.sequence + 1) % 256
        return sequence

    def encode(self, message: Message) -> bytes:
        """Frame of a message under the next number; raises MessageError for a value that does not fit."""
        return encode_message(message, self.next_sequence())


def longest_stuffed_length(number_of_actuators: int) -> int:
    """Bytes of the longest frame without its delimiter: COBS adds one byte, and one for each 254."""
    plain = messages.longest_body_length(number_of_actuators) + _CHECKSUM_SIZE
    return plain + 1 + plain // 254


class FrameDecoder:
    """Decoder of a stream of bytes; bounded, and in step again at the next delimiter whatever came before.

    A device gives its number of actuators; a host needs none, since what it receives does not depend on it.
    """

    def __init__(self, number_of_actuators: int = messages.MAXIMUM_ACTUATORS) -> None:
        self.counters = FramingCounters()
        self._number_of_actuators = number_of_actuators
        self._capacity = longest_stuffed_length(number_of_actuators)
        self._buffer = b""
        self._is_discarding = False
        self._delimiters_in_a_row = 0

    def receive(self, data: bytes) -> list[bytes | Signal]:
        """Bodies with a valid checksum and length, and emergency stops, in the order of the stream."""
        *segments, rest = data.split(DELIMITER)
        received: list[bytes | Signal] = []
        for segment in segments:
            self._extend(segment)
            item = self._end_segment()
            if item is not None:
                received.append(item)
        self._extend(rest)
        return received

    def _extend(self, data: bytes) -> None:
        if self._is_discarding:
            return
        self._buffer += data
        if len(self._buffer) > self._capacity:
            self.counters.overrun += 1
            self._buffer = b""
            self._is_discarding = True

    def _end_segment(self) -> bytes | Signal | None:
        segment, self._buffer = self._buffer, b""
        is_empty = not segment and not self._is_discarding
        self._is_discarding = False
        self._delimiters_in_a_row = self._delimiters_in_a_row + 1 if is_empty else 1
        if self._delimiters_in_a_row == EMERGENCY_STOP_RUN:
            return Signal.EMERGENCY_STOP
        return self._accept(segment) if segment else None

    def _accept(self, segment: bytes) -> bytes | None:
        try:
            content: bytes = cobs.decode(segment)
        except cobs.DecodeError:
            self.counters.framing += 1
            return None
        body, checksum = content[:-_CHECKSUM_SIZE], content[-_CHECKSUM_SIZE:]
        if len(body) < _SHORTEST_BODY:
            self.counters.length += 1
            return None
        seed = messages.seed_of(body[0])
        if seed is None or zlib.crc32(body, seed) != int.from_bytes(checksum, "little"):
            self.counters.crc += 1
            return None
        if not messages.has_exact_length(body, self._number_of_actuators):
            self.counters.length += 1
            return None
        self.counters.ok += 1
        return body


def occupied_ns(bit_rate_hz: int, size: int) -> int:
    """Duration for which `size` bytes occupy a serial line; USB, which ignores the bit rate, is taken for one."""
    return size * UART_BITS_PER_BYTE * NS_PER_S // bit_rate_hz


def sensed_rate_hz(bit_rate_hz: int, number_of_actuators: int) -> float:
    """Samples a second of an accelerometer that the line carries in ACCELERATION, in SENSED_SHARE of its time."""
    samples = messages.MAXIMUM_SENSED_VALUES // (1 + number_of_actuators)
    values = (0,) * samples * (1 + number_of_actuators)
    size = len(encode_message(messages.Acceleration(0, 0, 0, len(values), values), 0))
    return SENSED_SHARE * samples * NS_PER_S / occupied_ns(bit_rate_hz, size)
