"""The C core and the Python one do the same: every byte they send, every state, every sample within rounding."""

import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from firmware_link.emulator import DeviceConfiguration, EmulatedFirmware, synthesise
from firmware_link.emulator.c_core import CompiledFirmware
from firmware_link.protocol.basis import transfer_messages
from firmware_link.protocol.framing import EMERGENCY_STOP, encode_message
from firmware_link.protocol.layout import Message
from firmware_link.protocol.messages import (
    FULL_SCALE_WORD,
    MAGIC,
    VERSION_MAJOR,
    VERSION_MINOR,
    Ack,
    Arm,
    BasisBegin,
    ChannelDrive,
    DeviceState,
    Fault,
    HelloRequest,
    KeepAlive,
    Play,
    Result,
    Sense,
    Set,
    SetFlag,
    Stop,
    TimeRequest,
    encode_drive,
)
from tests.firmware_link.clicks import Clicks
from tests.firmware_link.conformance import hump
from tests.firmware_link.firmware.compiled_core import FULL_OUTPUT, core_library
from tests.firmware_link.strategies import RESOLUTION_HZ, messages, unhurried
from tests.firmware_link.virtual_rig import BOOT_ID, reference

ACTUATORS = 2
# Commands fall on samples, so that both cores mean the same instant.
RATE_HZ = 40_000
SAMPLE_US = 25
SLEW_PER_S = 200
US_PER_S = 1_000_000
RAMP_US = US_PER_S // SLEW_PER_S
CONFIGURATION = DeviceConfiguration(
    BOOT_ID,
    ACTUATORS,
    synthesis_rate_hz=RATE_HZ,
    basis_capacity_bytes=2_000,
    longest_drive_s=1,
    sensor_rate_mhz=3_200_000,
    sensor_scale_nm_per_s2=38_303_000,
    sensor_greatest=4_095,
)
CLICKS = Clicks(2_000, [hump(1.0, -0.5), hump(0.5, 0.9, duration_us=7_000)])
TRANSFER = list(transfer_messages(CLICKS.basis.data))
# C writes 16 bits and moves amplitudes from sample to sample, so what changes may come two steps of the slew late.
EXAMPLES = int(os.environ.get("TACTABLE_EXAMPLES", 3 * settings().max_examples))
TOLERANCE = 3 * SLEW_PER_S / RATE_HZ + 1e-3


@dataclass
class Twins:
    """Both cores, given the same and compared after each step."""

    python: EmulatedFirmware = field(default_factory=lambda: EmulatedFirmware(CONFIGURATION))
    compiled: CompiledFirmware = field(default_factory=lambda: CompiledFirmware(core_library(), CONFIGURATION))
    now_us: int = 0
    sequence: int = 0
    applied: int = 0
    last: bytes = b""
    samples: NDArray[np.int16] = field(default_factory=lambda: np.empty((0, ACTUATORS), np.int16))

    def send(self, message: Message, step: int = 1) -> None:
        if isinstance(message, BasisBegin):
            # A waveform that still fades would stand still in C, whose memory the basis takes.
            self.wait(RAMP_US)
        self.sequence = (self.sequence + step) % 256
        self.last = encode_message(message, self.sequence)
        self.receive(self.last)

    def drive(self, message: Set | Play, step: int = 1) -> None:
        self.send(message, step)
        self.applied = self.sequence

    def receive(self, data: bytes) -> None:
        assert self.compiled.receive(data, self.now_us) == self.python.receive(data, self.now_us)
        self.compare()

    def wait(self, duration_us: int) -> None:
        self.now_us += duration_us
        assert self.compiled.advance(self.now_us) == self.python.advance(self.now_us)
        self.compare()

    def hang_up(self) -> None:
        assert self.compiled.hang_up(self.now_us) == self.python.hang_up(self.now_us)
        self.compare()

    def compare(self) -> None:
        assert self.compiled.state is self.python.state
        assert self.compiled.counters == self.python.counters
        assert self.compiled.framing_counters == self.python.framing_counters
        assert self.compiled.next_deadline_us() == self.python.next_deadline_us()
        if self.python.drive_log:
            wanted = [round(channel.amplitude * FULL_SCALE_WORD) for channel in self.python.drive_log[-1].channels]
            assert [aimed for _, aimed in self.compiled.amplitudes()] == wanted

    def sense(self, accelerations: list[int]) -> None:
        """The C core knows the displacements of an instant by itself; Python is told those of C."""
        self.samples = np.concatenate([self.samples, self.compiled.take_samples()])
        last = len(self.samples) - 1
        for acceleration in accelerations:
            self.compiled.sense_now(acceleration)
            self.python.sense(acceleration, self.samples[last].tolist() if last >= 0 else [0] * ACTUATORS, last)
        assert self.compiled.senses == self.python.senses

    def compare_samples(self) -> None:
        self.samples = np.concatenate([self.samples, self.compiled.take_samples()])
        got = self.samples / FULL_OUTPUT
        wanted = synthesise(self.python.drive_log, 0, self.now_us, RATE_HZ)
        np.testing.assert_allclose(got, wanted if wanted.size else np.zeros_like(got), rtol=0, atol=TOLERANCE)


Step = Callable[[Twins], None]

waits = st.integers(0, 12_000) | st.integers(0, 400)
frequencies = st.sampled_from([0.0, 60.0, 60.0, 90.0, 333.33, 655.35])
amplitudes = st.sampled_from([0.0, 0.0, 0.25, 0.7, 1.0])
phases = st.sampled_from([0.0, 1.0, 3.0])
drives = st.tuples(*[st.builds(ChannelDrive, frequencies, amplitudes, phases)] * ACTUATORS).map(
    lambda channels: encode_drive(channels, RESOLUTION_HZ)
)
ages_us = st.just(0) | st.integers(-60_000, 60_000)
sequence_steps = st.just(1) | st.sampled_from([0, 127, 128, 255])
limits = st.tuples(*[st.sampled_from([0, 20_000, FULL_SCALE_WORD])] * ACTUATORS)


def _set(drive: bytes, age_us: int, lease_ms: int, flags: SetFlag, step: int) -> Step:
    return lambda twins: twins.drive(Set(reference(twins.now_us - age_us), flags, lease_ms, drive), step)


def _play(index: int, amplitude: int, age_us: int) -> Step:
    return lambda twins: twins.drive(CLICKS.play(index, reference(twins.now_us - age_us), amplitude))


def _play_any(index: int, fraction_bits: int, weights: tuple[int, ...]) -> Step:
    return lambda twins: twins.drive(
        Play(reference(twins.now_us), index, fraction_bits, FULL_SCALE_WORD, len(weights), weights)
    )


def _keep(other: int, age_us: int, step: int) -> Step:
    return lambda twins: twins.send(KeepAlive(reference(twins.now_us - age_us), (twins.applied + other) % 256), step)


def _send(message: Message) -> Step:
    return lambda twins: twins.send(message)


def _receive(data: bytes) -> Step:
    return lambda twins: twins.receive(data)


def _settle(twins: Twins) -> None:
    for sequence in range(256):
        twins.receive(encode_message(Ack(Fault.type_byte, sequence, Result.OK), 1))


arms = st.builds(
    Arm,
    st.sampled_from([BOOT_ID, BOOT_ID, BOOT_ID, BOOT_ID + 1]),
    st.sampled_from([SLEW_PER_S, SLEW_PER_S, SLEW_PER_S, 0]),
    st.sampled_from([40, 40, 100, 7, 0, 101]),
    st.sampled_from([0, 0, 1, 2]),
    limits,
)
ordinary: st.SearchStrategy[Step] = st.one_of(
    waits.map(lambda samples: lambda twins: twins.wait(samples * SAMPLE_US)),
    st.builds(
        _set,
        drives,
        ages_us,
        st.sampled_from([40, 40, 255, 0]),
        st.sampled_from(SetFlag) | st.just(SetFlag(0)),
        sequence_steps,
    ),
    st.builds(_set, drives, st.just(0), st.just(40), st.just(SetFlag.WRITE_PHASE), st.just(1)),
    st.builds(_play, st.integers(0, 2), st.sampled_from([0, 30_000, FULL_SCALE_WORD]), ages_us),
    st.builds(_play, st.integers(0, 1), st.just(FULL_SCALE_WORD), st.just(0)),
    st.builds(_play_any, st.integers(0, 2), st.integers(0, 32), st.tuples(*[st.integers(-(2**15), 2**15 - 1)] * 2)),
    st.builds(_keep, st.sampled_from([0, 0, 1]), ages_us, sequence_steps),
    st.sampled_from([0, 1, 20, 2_500]).map(lambda lease_ms: _send(Sense(lease_ms))),
    st.lists(st.integers(-(2**15), 2**15 - 1), max_size=100).map(lambda counts: lambda twins: twins.sense(counts)),
)
rare: st.SearchStrategy[Step] = st.one_of(
    arms.map(_send),
    st.sampled_from(
        [
            HelloRequest(MAGIC, VERSION_MAJOR, VERSION_MINOR, 9),
            HelloRequest(MAGIC + 1, VERSION_MAJOR, VERSION_MINOR, 9),
            Stop(),
            TimeRequest(2**63),
        ]
    ).map(_send),
    st.sampled_from(TRANSFER).map(_send),
    messages(ACTUATORS).map(_send),
    st.sampled_from([EMERGENCY_STOP, EMERGENCY_STOP[1:]]).map(_receive),
    st.binary(max_size=400).map(_receive),
    st.just(lambda twins: twins.receive(twins.last)),
    st.just(Twins.hang_up),
    st.just(_settle),
)


def _ready(twins: Twins) -> None:
    for message in (HelloRequest(MAGIC, VERSION_MAJOR, VERSION_MINOR, 1), *TRANSFER):
        twins.send(message)
    twins.send(Arm(BOOT_ID, SLEW_PER_S, 40, 0, (FULL_SCALE_WORD,) * ACTUATORS))
    assert twins.python.state is DeviceState.ARMED


@settings(unhurried, max_examples=EXAMPLES)
@given(st.booleans(), st.lists(ordinary | ordinary | ordinary | rare, max_size=40))
def test_the_c_core_is_the_python_core_s_twin(is_ready: bool, steps: list[Step]) -> None:
    twins = Twins()
    try:
        if is_ready:
            _ready(twins)
        for step in steps:
            step(twins)
        twins.wait(400_000)
        twins.compare_samples()
    finally:
        twins.compiled.close()


# Most of these come during a crossfade, which takes up to 400 samples.
hurried: st.SearchStrategy[Step] = st.one_of(
    st.integers(0, 400).map(lambda samples: lambda twins: twins.wait(samples * SAMPLE_US)),
    st.builds(_set, drives, st.just(0), st.just(40), st.just(SetFlag.WRITE_PHASE) | st.just(SetFlag(0)), st.just(1)),
    st.builds(_set, drives, st.just(0), st.just(40), st.just(SetFlag.WRITE_PHASE), st.just(1)),
    st.just(_set(bytes(6 * ACTUATORS), 0, 40, SetFlag(0), 1)),
)


@settings(unhurried, max_examples=EXAMPLES)
@given(st.lists(hurried, min_size=4, max_size=30))
def test_the_twins_sound_the_same_through_crossfades_that_are_overtaken(steps: list[Step]) -> None:
    twins = Twins()
    try:
        _ready(twins)
        for step in steps:
            step(twins)
        twins.wait(60_000)
        twins.compare_samples()
    finally:
        twins.compiled.close()


@pytest.mark.parametrize("wait_us", range(0, 20_000, 500))
def test_both_have_room_for_a_click_again_at_the_same_instant(wait_us: int) -> None:
    twins = Twins()
    _ready(twins)
    for pause_us in (2_000, wait_us, 0):
        twins.drive(CLICKS.play(0, reference(twins.now_us)))
        twins.wait(pause_us)
    assert twins.python.counters.refused == (wait_us < RAMP_US)
    twins.wait(100_000)
    twins.compare_samples()
    twins.compiled.close()


@pytest.mark.parametrize(("armed_s", "own_s", "wanted_s"), [(2, 1, 1), (1, 2, 1), (0, 1, 1), (1, 0, 1), (0, 0, None)])
def test_the_shorter_of_two_on_time_limits_holds(armed_s: int, own_s: int, wanted_s: int | None) -> None:
    configuration = replace(CONFIGURATION, longest_drive_s=own_s)
    twins = Twins(EmulatedFirmware(configuration), CompiledFirmware(core_library(), configuration, keeps_samples=False))
    twins.send(HelloRequest(MAGIC, VERSION_MAJOR, VERSION_MINOR, 1))
    twins.send(Arm(BOOT_ID, SLEW_PER_S, 40, armed_s, (FULL_SCALE_WORD,) * ACTUATORS))
    drive = encode_drive([ChannelDrive(60.0, 1.0)] * ACTUATORS, RESOLUTION_HZ)
    driven_ms = 0
    while twins.python.state is not DeviceState.LATCHED and driven_ms < 2_500:
        twins.drive(Set(reference(twins.now_us), SetFlag.WRITE_PHASE, 40, drive))
        twins.wait(20_000)
        driven_ms += 20
    assert driven_ms == (2_500 if wanted_s is None else 1_000 * wanted_s)
    twins.compiled.close()
