"""Frames damaged in every way that a line knows, and what a decoder makes of them."""

import random
import zlib
from collections import Counter
from collections.abc import Callable, Sequence

from cobs import cobs

from firmware_link.protocol.framing import Signal, encode_frame
from firmware_link.protocol.layout import Layout
from firmware_link.protocol.messages import MESSAGES, Hello, has_exact_length, seed_of

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
