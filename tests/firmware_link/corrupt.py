"""Frames damaged in every way that a line knows; firmware/compare_decoders.py shows them to both decoders."""

import random
import zlib
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from inspect import isfunction

from cobs import cobs

from firmware_link.protocol.framing import Signal, encode_frame
from firmware_link.protocol.layout import Layout
from firmware_link.protocol.messages import MESSAGES, Hello, has_exact_length, seed_of

ACTUATORS = 2
BATCH = 2_000
FRAMES_OF_A_TYPE = 8

Chance = random.Random
Damage = Callable[[bytes, Chance], bytes]


def flip_one_bit(frame: bytes, chance: Chance) -> bytes:
    return _flip(frame, 1, chance)


def flip_two_bits(frame: bytes, chance: Chance) -> bytes:
    return _flip(frame, 2, chance)


def flip_some_bits(frame: bytes, chance: Chance) -> bytes:
    return _flip(frame, chance.randint(3, 9), chance)


def burst_of_bits(frame: bytes, chance: Chance) -> bytes:
    """Up to 40 bits in a row, more than the CRC is wide."""
    width = chance.randint(2, 40)
    at = chance.randrange(max(1, 8 * len(frame) - width))
    pattern = chance.getrandbits(width) | 1 | 1 << (width - 1)
    return (int.from_bytes(frame, "little") ^ pattern << at).to_bytes(len(frame) + 5, "little")[: len(frame)]


def replace_a_byte(frame: bytes, chance: Chance) -> bytes:
    at = chance.randrange(len(frame))
    return frame[:at] + bytes([chance.randrange(256)]) + frame[at + 1 :]


def truncate(frame: bytes, chance: Chance) -> bytes:
    return frame[: chance.randrange(len(frame))]


def lose_the_beginning(frame: bytes, chance: Chance) -> bytes:
    return frame[chance.randint(1, len(frame)) :]


def lose_bytes(frame: bytes, chance: Chance) -> bytes:
    at = chance.randrange(len(frame))
    return frame[:at] + frame[at + chance.randint(1, 4) :]


def insert_bytes(frame: bytes, chance: Chance) -> bytes:
    at = chance.randint(0, len(frame))
    return frame[:at] + chance.randbytes(chance.randint(1, 4)) + frame[at:]


def double_a_byte(frame: bytes, chance: Chance) -> bytes:
    at = chance.randrange(len(frame))
    return frame[: at + 1] + frame[at:]


def swap_bytes(frame: bytes, chance: Chance) -> bytes:
    data = bytearray(frame)
    i, j = chance.randrange(len(data)), chance.randrange(len(data))
    data[i], data[j] = data[j], data[i]
    return bytes(data)


def zero_bytes(frame: bytes, chance: Chance) -> bytes:
    at = chance.randrange(len(frame))
    width = min(chance.randint(1, 4), len(frame) - at)
    return frame[:at] + bytes(width) + frame[at + width :]


def splice_two_frames(frame: bytes, chance: Chance) -> bytes:
    other = chance.choice(FRAMES)
    spliced = frame[: chance.randrange(1, len(frame))] + other[chance.randrange(1, len(other)) :]
    # Two frames may begin alike: then this would be the other one, whole.
    return spliced if spliced != other else frame


def noise(frame: bytes, chance: Chance) -> bytes:
    return chance.randbytes(len(frame))


def checksum_of_another_definition(frame: bytes, chance: Chance) -> bytes:
    body = _body(frame)
    seed = chance.getrandbits(32)
    stuffed: bytes = cobs.encode(body + zlib.crc32(body, seed).to_bytes(4, "little"))
    return stuffed + b"\0"


def another_length(frame: bytes, chance: Chance) -> bytes:
    """With its right checksum."""
    body = _body(frame)
    changed = body[: chance.randint(2, len(body) - 1)] if chance.random() < 0.5 and len(body) > 2 else body + b"\0"
    return encode_frame(changed) if not has_exact_length(changed, ACTUATORS) else frame[:-2] + b"\0"


DAMAGES: tuple[Damage, ...] = tuple(
    each for each in list(globals().values()) if isfunction(each) and each.__module__ == __name__
)
"""All that stand above."""


@dataclass(frozen=True)
class Batch:
    """A stream of damaged frames, each followed by a delimiter and a whole frame, and what those were."""

    stream: bytes
    damaged: list[bytes]
    whole: list[bytes]


def make_batch(damage: Damage, size: int, chance: Chance) -> Batch:
    """`size` damaged frames; bodies of what they were, and of the whole ones between them."""
    frames, whole = chance.choices(FRAMES, k=size), chance.choices(WHOLE_FRAMES, k=size)
    parts = [damage(frame, chance) + b"\0" + good for frame, good in zip(frames, whole, strict=True)]
    return Batch(b"".join(parts), [BODIES[f] for f in frames], [BODIES[f] for f in whole])


def count_outcomes(batch: Batch, received: Sequence[bytes | Signal]) -> Counter[str]:
    """What became of a batch; raises AssertionError for a frame that was not sent, or a whole one that was lost."""
    outcomes, at = Counter[str](), 0
    for damaged, whole in zip(batch.damaged, batch.whole, strict=True):
        first = received[at] if at < len(received) else None
        second = received[at + 1] if at + 1 < len(received) else None
        if first == whole:
            outcomes["refused"] += 1
            at += 1
        elif first == damaged and second == whole:
            # The damage was to the delimiter, or it changed nothing.
            outcomes["what was sent"] += 1
            at += 2
        else:
            raise AssertionError(f"after {damaged.hex(' ')}: {first!r}, {second!r} instead of {whole.hex(' ')}")
    assert at == len(received), f"{len(received) - at} frames more than were sent"
    return outcomes


def _flip(frame: bytes, bits: int, chance: Chance) -> bytes:
    pattern = 0
    for _ in range(bits):
        pattern |= 1 << chance.randrange(8 * len(frame))
    return (int.from_bytes(frame, "little") ^ pattern).to_bytes(len(frame), "little")


def _body(frame: bytes) -> bytes:
    content: bytes = cobs.decode(frame[:-1])
    return content[:-4]


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
