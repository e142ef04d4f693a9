"""Laws of the onsets: gains hold until their times, and what cannot be a shape is refused."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_link.emulator.drive_log import Cause
from firmware_link.emulator.firmware import DeviceConfiguration, EmulatedFirmware
from firmware_link.protocol.errors import MessageError
from firmware_link.protocol.framing import encode_message
from firmware_link.protocol.messages import (
    MAGIC,
    NUMBER_OF_SHAPES,
    SHAPE_FULL_GAIN,
    Arm,
    ChannelDrive,
    HelloRequest,
    Result,
    Set,
    SetFlag,
    encode_drive,
)
from firmware_link.protocol.onset import Onset, OnsetStep, ShapeStore, make_shape
from tests.firmware_link.strategies import RESOLUTION_HZ, unhurried
from tests.firmware_link.virtual_rig import BOOT_ID, BareHost, reference

START_US = 5_000
DRIVE = encode_drive([ChannelDrive(100, 1.0), ChannelDrive(100, 0.5)], RESOLUTION_HZ)
steps_of_shapes = st.lists(st.tuples(st.integers(0, 400), st.integers(0, 2_000)), max_size=3).map(sorted)


@unhurried
@given(steps_of_shapes, st.integers(0, 50_000))
def test_each_gain_holds_until_its_time_and_then_all_is_full(steps: list[tuple[int, int]], elapsed_us: int) -> None:
    onset = Onset(START_US, tuple((100 * until, gain) for until, gain in steps))
    passed = [gain for until, gain in steps if 100 * until > elapsed_us]
    assert onset.gain_at(START_US + elapsed_us) == (passed[0] if passed else SHAPE_FULL_GAIN)
    following = [100 * until for until, _ in steps if 100 * until > elapsed_us]
    assert onset.next_step_us(START_US + elapsed_us) == (START_US + following[0] if following else None)


def test_a_shape_is_kept_as_it_was_told() -> None:
    store = ShapeStore()
    assert store.define(make_shape(3, [OnsetStep(0.01, 0.25), OnsetStep(0.02, 1.5)])) is Result.OK
    assert store.onset(4, 7) == Onset(7, ((10_000, 250), (20_000, 1_500)))
    assert store.onset(0, 7) == store.onset(1, 7) == Onset(7, ())


def test_a_shape_out_of_range_is_refused_and_changes_nothing() -> None:
    store = ShapeStore()
    store.define(make_shape(0, [OnsetStep(0.01, 0.5)]))
    with pytest.raises(MessageError, match=r"onset 1 end at \[0.02, 0.01\] s; expected rising times"):
        make_shape(0, [OnsetStep(0.02, 1), OnsetStep(0.01, 1)])
    assert store.define(make_shape(NUMBER_OF_SHAPES, [])) is Result.OUT_OF_RANGE
    assert store.onset(1, 0) == Onset(0, ((10_000, 500),))


def host_with_shape(*steps: OnsetStep) -> BareHost:
    host = BareHost(EmulatedFirmware(DeviceConfiguration(BOOT_ID)))
    host.send(HelloRequest(MAGIC, 1, 0, 1), 0)
    host.send(make_shape(0, steps), 0)
    host.send(Arm(BOOT_ID, 1000, 100, 0, (40_000, 40_000)), 0)
    return host


def shaped(host: BareHost, drive: bytes, now_us: int) -> None:
    host.send(Set(reference(now_us), SetFlag.WRITE_PHASE, 100, 1, drive), now_us)


def test_renewals_and_changes_keep_the_course_and_silence_ends_it() -> None:
    host = host_with_shape(OnsetStep(0.02, 0.5))
    louder, quieter = (
        encode_drive([ChannelDrive(100, 0.4)] * 2, RESOLUTION_HZ),
        encode_drive([ChannelDrive(100, 0.2)] * 2, RESOLUTION_HZ),
    )
    for drive, now_us in ((quieter, 0), (quieter, 5_000), (louder, 10_000), (louder, 25_000), (bytes(12), 30_000)):
        shaped(host, drive, now_us)
    shaped(host, louder, 40_000)
    log = [(e.device_time_us, e.cause, round(e.channels[0].amplitude, 3)) for e in host.firmware.drive_log]
    assert log == [
        (0, Cause.SET, 0.1),
        (10_000, Cause.SET, 0.2),
        (20_000, Cause.ONSET, 0.4),
        (30_000, Cause.SET, 0.0),
        (40_000, Cause.SET, 0.2),
    ]


def test_a_gain_above_one_ends_at_the_limit() -> None:
    host = host_with_shape(OnsetStep(0.02, 1.5))
    shaped(host, DRIVE, 0)
    host.firmware.advance(20_000)
    amplitudes = [[round(65_535 * channel.amplitude) for channel in e.channels] for e in host.firmware.drive_log]
    assert amplitudes == [[40_000, 40_000], [40_000, 32_768]]


def test_a_shape_needs_an_idle_device() -> None:
    host = host_with_shape()
    host.firmware.receive(encode_message(make_shape(0, [OnsetStep(0.02, 0.1)]), 77), 10)
    shaped(host, DRIVE, 20)
    assert host.firmware.drive_log[0].channels[1].amplitude == pytest.approx(0.5, abs=1e-4)
