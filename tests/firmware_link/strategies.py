"""Hypothesis strategies: messages of every type, and drives."""

import math
from enum import Enum
from typing import Any, cast

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from firmware_link.emulator.drive_log import Cause, ChannelTarget, DriveEvent
from firmware_link.protocol.basis import SAMPLE_FULL_SCALE, Basis, BasisSet
from firmware_link.protocol.drive_words import ChannelDrive
from firmware_link.protocol.layout import Layout, Message, Word
from firmware_link.protocol.messages import MESSAGES, Hello

BITS = {"u8": 8, "u16": 16, "u32": 32, "u64": 64}
RESOLUTION_HZ = 0.01

# The machine may be slow; a law has no deadline.
unhurried = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])

sequences = st.integers(0, 255)


@st.composite
def messages(draw: st.DrawFn, number_of_actuators: int) -> Message:
    """Any message that is valid for this number of actuators."""
    layout = Layout(draw(st.sampled_from(MESSAGES)))
    values: list[Any] = [
        draw(_word(word) if kind in (int, bytes) else st.sampled_from(cast(type[Enum], kind)))
        for (_, word), kind in zip(layout.words, layout.converters, strict=True)
    ]
    repetitions = number_of_actuators if layout.most is None else draw(st.integers(0, layout.most))
    if layout.message is Hello or layout.most is not None:
        values[-1] = repetitions
    if layout.repeated:
        size = layout.length(repetitions) - layout.length(0)
        values.append(draw(_repeated(layout, size, repetitions)))
    return layout.message(*values)


channel_drives = st.builds(
    ChannelDrive, frequency_hz=st.floats(0, 655.35), amplitude=st.floats(0, 1), phase_rad=st.floats(-10, 10)
)


@st.composite
def drive_logs(draw: st.DrawFn, number_of_actuators: int) -> list[DriveEvent]:
    """A log as the firmware leaves it: phases are written to sounding channels only, all at once."""
    times_us = draw(st.lists(st.integers(0, 60_000), min_size=1, max_size=8).map(sorted))
    slew_per_s = draw(st.sampled_from([20.0, 100.0, 1000.0]))
    return [DriveEvent(time_us, Cause.SET, 0, slew_per_s, draw(_targets(number_of_actuators))) for time_us in times_us]


@st.composite
def _targets(draw: st.DrawFn, number_of_actuators: int) -> tuple[ChannelTarget, ...]:
    writes_phase = draw(st.booleans())
    targets = []
    for _ in range(number_of_actuators):
        amplitude = draw(st.sampled_from([0.0, 0.25, 0.5, 1.0]))
        phase_rad = draw(st.floats(0, math.tau)) if writes_phase and amplitude else None
        targets.append(ChannelTarget(draw(st.floats(1, 600)), amplitude, phase_rad))
    return tuple(targets)


def _word(word: Word) -> st.SearchStrategy[Any]:
    if word.block_size is not None:
        return st.binary(min_size=word.block_size, max_size=word.block_size)
    if word.kind == "i16":
        return st.integers(-(2**15), 2**15 - 1)
    return st.integers(0, 2 ** BITS[word.kind] - 1)


def _repeated(layout: Layout, size: int, repetitions: int) -> st.SearchStrategy[Any]:
    if layout.repeated_is_raw:
        return st.binary(min_size=size, max_size=size)
    assert layout.repeated is not None
    words = [_word(word) for _, word in layout.repeated[1].words]
    return st.tuples(*words * repetitions)


@st.composite
def bases(draw: st.DrawFn) -> Basis:
    chance = np.random.default_rng(draw(st.integers(0, 2**32)))
    shapes = draw(st.lists(st.tuples(st.integers(1, 12), st.integers(2, 60)), min_size=1, max_size=5))
    sets = []
    for shape in shapes:
        functions = chance.integers(-SAMPLE_FULL_SCALE, SAMPLE_FULL_SCALE, shape, endpoint=True)
        functions[:, [0, -1]] = 0
        sets.append(BasisSet(functions.astype(np.int16), chance.integers(0, 3, shape[0]).astype(np.uint8)))
    return Basis(draw(st.integers(1, 65_535)), tuple(sets))
