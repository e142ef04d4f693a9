"""Laws of the firmware: it drives only what was armed, for as long as it is told, and falls silent by itself."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_link.emulator import LONGEST_LEASE_MS, Cause, DeviceConfiguration, EmulatedFirmware, Outcome, synthesise
from firmware_link.protocol.framing import encode_message
from firmware_link.protocol.messages import (
    Arm,
    ChannelDrive,
    DeviceState,
    Status,
    encode_drive,
)
from tests.firmware_link.strategies import RESOLUTION_HZ, messages, unhurried
from tests.firmware_link.virtual_rig import BOOT_ID, BareHost, decode_messages

DRIVE = encode_drive([ChannelDrive(60, 1.0), ChannelDrive(90, 0.5, 1.0)], RESOLUTION_HZ)
OTHER_DRIVE = encode_drive([ChannelDrive(200, 0.3), ChannelDrive(90, 0.5, 1.0)], RESOLUTION_HZ)
RAMP_US = 5_000


def driving_host(now_us: int = 1000, lease_ms: int = 40) -> BareHost:
    host = BareHost()
    host.arm(now_us, lease_ms=lease_ms)
    host.set(DRIVE, now_us, lease_ms)
    assert host.firmware.state is DeviceState.DRIVING
    return host


def greatest_after(host: BareHost, device_us: int) -> float:
    return float(np.abs(synthesise(host.firmware.drive_log, device_us, device_us + 100_000, 20_000)).max())


@unhurried
@given(st.lists(st.binary(max_size=80) | messages(2).map(lambda message: encode_message(message, 1)), max_size=20))
def test_no_bytes_drive_a_device_that_is_not_armed(chunks: list[bytes]) -> None:
    firmware = EmulatedFirmware(DeviceConfiguration(boot_id=2**32 - 1))
    for index, chunk in enumerate(chunks):
        firmware.receive(chunk, 1000 * index)
    assert firmware.drive_log == []


@unhurried
@given(st.integers(1, LONGEST_LEASE_MS), st.integers(0, 255))
def test_amplitude_is_zero_within_lease_and_ramp(armed_lease_ms: int, lease_ms: int) -> None:
    host = BareHost()
    host.arm(1000, lease_ms=armed_lease_ms)
    host.set(DRIVE, 1000, lease_ms)
    host.firmware.run_until(240_000)
    lease_us = min(armed_lease_ms, lease_ms) * 1000
    assert [(event.cause, event.device_time_us) for event in host.firmware.drive_log] == [
        (Cause.SET, 1000),
        (Cause.LEASE_EXPIRED, 1000 + lease_us),
    ]
    assert greatest_after(host, 1000 + lease_us + RAMP_US) == 0.0
    assert host.firmware.counters.trips == 1


@unhurried
@given(st.integers(-3_000_000, 3_000_000))
def test_a_set_older_or_younger_than_a_lease_is_stale(age_us: int) -> None:
    host = BareHost()
    host.arm(10_000_000)
    host.set(DRIVE, 10_000_000, age_us=age_us)
    is_applied = bool(host.firmware.drive_log)
    assert is_applied or abs(age_us) > 39_900
    assert not is_applied or abs(age_us) < 40_100


def test_limits_are_the_devices_own() -> None:
    host = BareHost()
    host.arm(1000, limit=16_384, slew=65_535)
    host.set(encode_drive([ChannelDrive(0.5, 1.0), ChannelDrive(655.0, 0.1)], RESOLUTION_HZ), 2000)
    (event,) = host.firmware.drive_log
    assert [channel.amplitude for channel in event.channels] == pytest.approx([0.25, 0.1], abs=1e-4)
    assert event.channels[0].frequency_hz == pytest.approx(1.0)
    assert event.slew_per_s == 1000


def test_a_renewal_of_a_running_drive_changes_nothing() -> None:
    host = driving_host()
    for now_us in range(11_000, 100_000, 10_000):
        host.set(DRIVE, now_us)
    assert len(host.firmware.drive_log) == 1
    assert host.firmware.counters.applied == 10


def test_the_level_changes_without_a_phase_write() -> None:
    host = driving_host()
    host.set(encode_drive([ChannelDrive(60, 0.2), ChannelDrive(90, 0.1, 1.0)], RESOLUTION_HZ), 10_000)
    assert [channel.phase_rad for channel in host.firmware.drive_log[-1].channels] == [None, None]


def test_phases_are_written_all_at_once_or_not_at_all() -> None:
    host = driving_host()
    host.set(OTHER_DRIVE, 10_000)
    first, second = (channel.phase_rad for channel in host.firmware.drive_log[-1].channels)
    assert first == 0.0
    assert second is not None
    assert math.isclose(second, 1.0, abs_tol=1e-4)


def test_a_silent_channel_keeps_its_frequency() -> None:
    host = driving_host()
    host.set(bytes(12), 10_000)
    assert [channel.frequency_hz for channel in host.firmware.drive_log[-1].channels] == pytest.approx([60, 90])


def test_status_tells_the_last_set_applied() -> None:
    host = driving_host()
    said = decode_messages(host.set(OTHER_DRIVE, 20_000))
    (status,) = (message for message in said if isinstance(message, Status))
    assert (status.state, status.applied_sequence, status.applied_time_us) == (
        DeviceState.DRIVING,
        host.sequence,
        20_000,
    )
    assert status.applied == 2
    assert decode_messages(host.set(DRIVE, 25_000)) == []
    assert len(decode_messages(host.firmware.run_until(30_000))) == 1


def test_a_frame_that_can_be_no_copy_is_fresh_whatever_its_number() -> None:
    """A copy can pass the clock for two leases."""
    host = driving_host()
    for after_us, outcome in ((80_000, Outcome.STALE), (80_001, Outcome.ACCEPTED)):
        host.sequence -= 2
        host.set(DRIVE, 1_000 + after_us)
        assert host.firmware.received[-1].outcome is outcome


def test_the_log_tells_what_became_of_each_frame() -> None:
    host = driving_host()
    host.set(DRIVE, 10_000)
    host.set(DRIVE, 20_000, age_us=50_000)
    sets = [frame for frame in host.firmware.received if frame.message == "SET"]
    assert [(frame.device_time_us, frame.sequence, frame.outcome) for frame in sets] == [
        (1000, 3, Outcome.ACCEPTED),
        (10_000, 4, Outcome.ACCEPTED),
        (20_000, 5, Outcome.STALE),
    ]


def test_limits_of_a_new_arm_hold_from_the_next_set_on() -> None:
    host = driving_host()
    host.set(bytes(12), 10_000)
    host.send(Arm(BOOT_ID, 100, 40, 0, (16_384, 16_384)), 11_000)
    assert host.firmware.drive_log[-1].slew_per_s == 200
    host.set(DRIVE, 12_000)
    assert host.firmware.drive_log[-1].slew_per_s == 100
    assert host.firmware.drive_log[-1].channels[0].amplitude == pytest.approx(0.25, abs=1e-4)


def test_a_board_that_cannot_be_is_refused() -> None:
    with pytest.raises(ValueError, match="3 full scales for 2 actuators"):
        DeviceConfiguration(BOOT_ID, full_scales_pm=(1, 2, 3))
    with pytest.raises(ValueError, match="number_of_actuators is 0"):
        DeviceConfiguration(BOOT_ID, 0)
