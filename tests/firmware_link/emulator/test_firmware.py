"""Laws of the firmware: it drives only what was armed, for as long as it is told, and falls silent by itself."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_link.emulator import DeviceConfiguration, EmulatedFirmware, Outcome
from firmware_link.protocol.framing import encode_message
from firmware_link.protocol.messages import Arm, ChannelDrive, DeviceState, encode_drive
from tests.firmware_link.strategies import RESOLUTION_HZ, messages, unhurried
from tests.firmware_link.virtual_rig import BOOT_ID, BareHost

DRIVE = encode_drive([ChannelDrive(60, 1.0), ChannelDrive(90, 0.5, 1.0)], RESOLUTION_HZ)


def driving_host() -> BareHost:
    host = BareHost()
    host.arm(1000)
    host.set(DRIVE, 1000)
    assert host.firmware.state is DeviceState.DRIVING
    return host


@unhurried
@given(st.lists(st.binary(max_size=80) | messages(2).map(lambda message: encode_message(message, 1)), max_size=20))
def test_no_bytes_drive_a_device_that_is_not_armed(chunks: list[bytes]) -> None:
    firmware = EmulatedFirmware(DeviceConfiguration(boot_id=2**32 - 1))
    for index, chunk in enumerate(chunks):
        firmware.receive(chunk, 1000 * index)
    assert firmware.drive_log == []


def test_limits_are_the_devices_own() -> None:
    host = BareHost()
    host.arm(1000, limit=16_384, slew=65_535)
    host.set(encode_drive([ChannelDrive(0.5, 1.0), ChannelDrive(655.0, 0.1)], RESOLUTION_HZ), 2000)
    (event,) = host.firmware.drive_log
    assert [channel.amplitude for channel in event.channels] == pytest.approx([0.25, 0.1], abs=1e-4)
    assert event.channels[0].frequency_hz == pytest.approx(1.0)
    assert event.slew_per_s == 1000


def test_a_frame_that_can_be_no_copy_is_fresh_whatever_its_number() -> None:
    """A copy can pass the clock for two leases."""
    host = driving_host()
    for after_us, outcome in ((80_000, Outcome.STALE), (80_001, Outcome.ACCEPTED)):
        host.sequence -= 2
        host.set(DRIVE, 1_000 + after_us)
        assert host.firmware.received[-1].outcome is outcome


def test_a_silent_channel_keeps_its_frequency_and_limits_of_a_new_arm_hold_from_the_next_set_on() -> None:
    host = driving_host()
    host.set(bytes(12), 10_000)
    assert [channel.frequency_hz for channel in host.firmware.drive_log[-1].channels] == pytest.approx([60, 90])
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
