"""Laws of the C frames: the decoder accepts, refuses and counts as the Python one does, whatever comes."""

import ctypes
import itertools
import os
import random
import zlib
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from cobs import cobs
from hypothesis import given
from hypothesis import strategies as st

from firmware_link.emulator.c_core import open_library
from firmware_link.protocol.framing import (
    DELIMITER,
    EMERGENCY_STOP,
    FrameDecoder,
    FramingCounters,
    Signal,
    encode_frame,
    encode_message,
)
from firmware_link.protocol.layout import Layout
from firmware_link.protocol.link_errors import LinkError
from firmware_link.protocol.messages import (
    MAXIMUM_WEIGHTS,
    MESSAGES,
    Features,
    Hello,
    Play,
    encode_body,
    has_exact_length,
    seed_of,
)
from tests.firmware_link.firmware.compiled_core import core_library
from tests.firmware_link.strategies import messages, sequences, unhurried

_u8_p, _u32_p = ctypes.POINTER(ctypes.c_uint8), ctypes.POINTER(ctypes.c_uint32)
# As c/decoder.c defines them: each with its result and its arguments.
_SIGNATURES = {
    "decoder_open": (ctypes.c_void_p, ctypes.c_uint8),
    "decoder_close": (None, ctypes.c_void_p),
    "decoder_receive": (ctypes.c_size_t, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_size_t, _u8_p),
    "decoder_counters": (None, ctypes.c_void_p, _u32_p),
}
_LENGTH_SIZE = 2
# More than any frame: a body is shorter than its frame, which may have come in pieces before.
_FRAME_ROOM = 65_536


class CompiledDecoder:
    """The C core's frame decoder by itself."""

    def __init__(self, library: ctypes.CDLL, number_of_actuators: int) -> None:
        for name, (result, *arguments) in _SIGNATURES.items():
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
        self._library = library
        self._decoder = library.decoder_open(number_of_actuators)

    def close(self) -> None:
        """Free the decoder; nothing else may be called afterwards."""
        self._library.decoder_close(self._decoder)

    @property
    def counters(self) -> FramingCounters:
        """Frames accepted and refused since the decoder was made."""
        counters = (ctypes.c_uint32 * 5)()
        self._library.decoder_counters(self._decoder, counters)
        return FramingCounters(*counters)

    def receive(self, data: bytes) -> list[bytes | Signal]:
        """Bodies with a valid checksum and length, and emergency stops, in the order of the stream."""
        out = np.empty(3 * len(data) + _FRAME_ROOM, np.uint8)
        size = self._library.decoder_receive(self._decoder, data, len(data), out.ctypes.data_as(_u8_p))
        return _split(out[:size].tobytes())


def _split(items: bytes) -> list[bytes | Signal]:
    received: list[bytes | Signal] = []
    at = 0
    while at < len(items):
        length = int.from_bytes(items[at : at + _LENGTH_SIZE], "little")
        at += _LENGTH_SIZE
        received.append(items[at : at + length] if length else Signal.EMERGENCY_STOP)
        at += length
    return received


ACTUATORS = 2
FRAMES_OF_A_TYPE = 8

Chance = random.Random


def _flip(frame: bytes, chance: Chance, bits: int) -> bytes:
    pattern = 0
    for _ in range(bits):
        pattern |= 1 << chance.randrange(8 * len(frame))
    return (int.from_bytes(frame, "little") ^ pattern).to_bytes(len(frame), "little")


def _burst(frame: bytes, chance: Chance) -> bytes:
    """Up to 40 bits in a row, more than the CRC is wide."""
    width = chance.randint(2, 40)
    at = chance.randrange(max(1, 8 * len(frame) - width))
    pattern = chance.getrandbits(width) | 1 | 1 << (width - 1)
    return (int.from_bytes(frame, "little") ^ pattern << at).to_bytes(len(frame) + 5, "little")[: len(frame)]


def _edit(frame: bytes, chance: Chance, lost: int, inserted: bytes) -> bytes:
    at = chance.randrange(len(frame))
    return frame[:at] + inserted + frame[at + lost :]


def _double(frame: bytes, chance: Chance) -> bytes:
    at = chance.randrange(len(frame))
    return frame[: at + 1] + frame[at:]


def _swap(frame: bytes, chance: Chance) -> bytes:
    data = bytearray(frame)
    i, j = chance.randrange(len(data)), chance.randrange(len(data))
    data[i], data[j] = data[j], data[i]
    return bytes(data)


def _splice(frame: bytes, chance: Chance) -> bytes:
    other = chance.choice(FRAMES)
    spliced = frame[: chance.randrange(1, len(frame))] + other[chance.randrange(1, len(other)) :]
    # Two frames may begin alike: then this would be the other one, whole.
    return spliced if spliced != other else frame


def _give_another_checksum(frame: bytes, chance: Chance) -> bytes:
    body = BODIES[frame]
    stuffed: bytes = cobs.encode(body + zlib.crc32(body, chance.getrandbits(32)).to_bytes(4, "little"))
    return stuffed + b"\0"


def _give_another_length(frame: bytes, chance: Chance) -> bytes:
    """With its right checksum."""
    body = BODIES[frame]
    changed = body[: chance.randint(2, len(body) - 1)] if chance.random() < 0.5 and len(body) > 2 else body + b"\0"
    return encode_frame(changed) if not has_exact_length(changed, ACTUATORS) else frame[:-2] + b"\0"


DAMAGES: dict[str, Callable[[bytes, Chance], bytes]] = {
    "a bit flipped": lambda frame, chance: _flip(frame, chance, 1),
    "two bits flipped": lambda frame, chance: _flip(frame, chance, 2),
    "some bits flipped": lambda frame, chance: _flip(frame, chance, chance.randint(3, 9)),
    "a burst": _burst,
    "a byte replaced": lambda frame, chance: _edit(frame, chance, 1, chance.randbytes(1)),
    "the end lost": lambda frame, chance: frame[: chance.randrange(len(frame))],
    "the beginning lost": lambda frame, chance: frame[chance.randint(1, len(frame)) :],
    "bytes lost": lambda frame, chance: _edit(frame, chance, chance.randint(1, 4), b""),
    "bytes inserted": lambda frame, chance: _edit(frame, chance, 0, chance.randbytes(chance.randint(1, 4))),
    "bytes of zeros": lambda frame, chance: _edit(frame, chance, width := chance.randint(1, 4), bytes(width)),
    "a byte doubled": _double,
    "bytes swapped": _swap,
    "two frames spliced": _splice,
    "noise": lambda frame, chance: chance.randbytes(len(frame)),
    "another checksum": _give_another_checksum,
    "another length": _give_another_length,
}


def draw_batch(size: int, chance: Chance) -> list[tuple[bytes, bytes]]:
    """Frames to damage, each with the one that follows whole."""
    return list(zip(chance.choices(FRAMES, k=size), chance.choices(WHOLE_FRAMES, k=size), strict=True))


def count_outcomes(batch: Sequence[tuple[bytes, bytes]], received: Sequence[bytes | Signal]) -> Counter[str]:
    """What became of damaged frames; raises AssertionError for one that was not sent, or a whole one that was lost."""
    outcomes, at = Counter[str](), 0
    for damaged, whole in batch:
        if received[at] == BODIES[whole]:
            outcomes["refused"] += 1
        else:
            # The damage was to the delimiter, or it changed nothing.
            assert received[at] == BODIES[damaged] and received[at + 1] == BODIES[whole], damaged.hex(" ")
            outcomes["what was sent"] += 1
            at += 1
        at += 1
    assert at == len(received), f"{len(received) - at} frames more than were sent"
    return outcomes


def _random_body(layout: Layout, chance: Chance) -> bytes:
    """A body of valid length; what its words mean does not matter to a decoder of frames."""
    repetitions = ACTUATORS if layout.most is None else chance.randint(0, layout.most)
    body = bytearray(chance.randbytes(layout.length(repetitions)))
    body[0] = layout.message.type_byte
    # Zeros are what COBS is about.
    for at in range(2, len(body)):
        if chance.random() < 0.3:
            body[at] = 0
    if layout.message is Hello or layout.most is not None:
        body[layout.length(0) - 1] = repetitions
    assert seed_of(body[0]) is not None
    return bytes(body)


def _make_frames() -> dict[bytes, bytes]:
    chance = Chance(0)
    bodies = [_random_body(Layout(message), chance) for message in MESSAGES for _ in range(FRAMES_OF_A_TYPE)]
    return {encode_frame(body): body for body in bodies}


BODIES = _make_frames()
"""Bodies by their frames."""
FRAMES = tuple(BODIES)[::2]
"""Those that are damaged, and those that stay whole: what is accepted tells which it was."""
WHOLE_FRAMES = tuple(BODIES)[1::2]


BATCH = 1_250
BATCHES = int(os.environ.get("TACTABLE_FRAME_BATCHES", "1"))
"""Of frames with each kind of damage."""
pieces = st.one_of(
    messages(ACTUATORS).map(lambda message: encode_message(message, 1)),
    st.builds(encode_body, messages(ACTUATORS), sequences).map(encode_frame),
    st.binary(max_size=300),
    st.sampled_from([DELIMITER, EMERGENCY_STOP, EMERGENCY_STOP[1:]]),
)


# Runs of 254 bytes without a zero, and a byte more or less, are where the code of a run is full.
runs = st.lists(st.sampled_from([1, 100, 253, 254, 255, 508, 509]).map(lambda size: b"\5" * size), max_size=4)


@unhurried
@given(st.one_of(st.binary(max_size=700), runs.map(b"\0".join)))
def test_bytes_are_stuffed_as_cobs_does_and_come_back(data: bytes) -> None:
    encode, decode = core_library().cobs_encode, core_library().cobs_decode
    encode.restype, decode.restype = ctypes.c_size_t, ctypes.c_bool
    out, size = ctypes.create_string_buffer(len(data) + len(data) // 254 + 2), ctypes.c_size_t()
    size.value = encode(data, ctypes.c_size_t(len(data)), out)
    assert out.raw[: size.value] == cobs.encode(data)
    assert decode(out, ctypes.byref(size)) and out.raw[: size.value] == data


@unhurried
@given(st.lists(pieces, max_size=20), st.lists(st.integers(0, 2_000), max_size=10))
def test_both_decoders_do_the_same_in_any_chunking(parts: list[bytes], cuts: list[int]) -> None:
    stream = b"".join(parts)
    edges = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    python, compiled = FrameDecoder(ACTUATORS), CompiledDecoder(core_library(), ACTUATORS)
    for start, stop in itertools.pairwise(edges):
        assert compiled.receive(stream[start:stop]) == python.receive(stream[start:stop])
    assert compiled.counters == python.counters
    compiled.close()


@pytest.mark.parametrize("damage", DAMAGES)
def test_both_decoders_refuse_the_same_damaged_frames(damage: str) -> None:
    chance, refused = Chance(f"3 {damage}"), 0
    python, compiled = FrameDecoder(ACTUATORS), CompiledDecoder(core_library(), ACTUATORS)
    for _ in range(BATCHES):
        batch = draw_batch(BATCH, chance)
        stream = b"".join(DAMAGES[damage](frame, chance) + b"\0" + whole for frame, whole in batch)
        received = compiled.receive(stream)
        assert received == python.receive(stream)
        refused += count_outcomes(batch, received)["refused"]
    assert compiled.counters == python.counters
    compiled.close()
    # Doubling a byte or the like may leave the frame as it was.
    assert refused > 0.85 * BATCH * BATCHES


@pytest.mark.parametrize("number_of_actuators", [1, 36, 100, 255])
def test_the_longest_frame_fits_the_buffer(number_of_actuators: int) -> None:
    full_scales_pm = (9,) * number_of_actuators
    sizes = (1, 1, 1, 1, 1, 1, 1, 1, 0, number_of_actuators)
    hello = Hello(1, 0, 1, 1, 1, Features(0), 0, 1, 0, *sizes, full_scales_pm)
    plays = (Play(0, 0, 14, 65_535, count, (1,) * count) for count in (0, 1, MAXIMUM_WEIGHTS))
    bodies = [encode_body(message, 1) for message in (hello, *plays)]
    compiled = CompiledDecoder(core_library(), number_of_actuators)
    for decoder in (compiled, FrameDecoder(number_of_actuators)):
        assert decoder.receive(b"".join(map(encode_frame, bodies))) == bodies
    compiled.close()


def test_a_file_that_is_no_library_is_named(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match=r"nothing\.so is no library"):
        open_library(tmp_path / "nothing.so")
