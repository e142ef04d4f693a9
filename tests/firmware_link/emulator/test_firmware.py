"""Laws of the firmware: it drives only what was armed, for as long as it is told, and falls silent by itself."""

from collections import deque
from types import SimpleNamespace
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_link.emulator.device_reports import Reports
from firmware_link.emulator.device_state import Device, DeviceConfiguration
from firmware_link.emulator.drive_log import Outcome
from firmware_link.emulator.firmware import EmulatedFirmware
from firmware_link.emulator.sense import Accelerations
from firmware_link.protocol.drive_words import ChannelDrive, encode_drive
from firmware_link.protocol.framing import encode_message
from firmware_link.protocol.messages import Acceleration, Arm, Result
from tests.firmware_link.law_host import Host
from tests.firmware_link.strategies import RESOLUTION_HZ, messages, unhurried
from tests.firmware_link.test_conformance import VirtualTier
from tests.firmware_link.virtual_rig import BOOT_ID

DRIVE = encode_drive([ChannelDrive(60, 1.0), ChannelDrive(90, 0.5, 1.0)], RESOLUTION_HZ)


def greeted() -> tuple[Host, Any]:
    tier = VirtualTier()
    host = Host(tier)
    host.greet()
    return host, tier.line.firmware


@unhurried
@given(st.lists(st.binary(max_size=80) | messages(2).map(lambda message: encode_message(message, 1)), max_size=20))
def test_no_bytes_drive_a_device_that_is_not_armed(chunks: list[bytes]) -> None:
    firmware = EmulatedFirmware(DeviceConfiguration(boot_id=2**32 - 1))
    for index, chunk in enumerate(chunks):
        firmware.receive(chunk, 1000 * index)
    assert firmware.drive_log == []


def test_limits_are_the_devices_own_and_those_of_a_new_arm_hold_from_the_next_set_on() -> None:
    host, firmware = greeted()
    assert host.ask(Arm(firmware.configuration.boot_id, 65_535, 40, 0, (16_384,) * 2)) is Result.OK
    host.set(encode_drive([ChannelDrive(0.5, 1.0), ChannelDrive(655.0, 0.1)], RESOLUTION_HZ))
    (event,) = firmware.drive_log
    assert [channel.amplitude for channel in event.channels] == pytest.approx([0.25, 0.1], abs=1e-4)
    assert [channel.frequency_hz for channel in event.channels] == pytest.approx([1.0, 655.0]), "1 Hz is the lowest"
    host.set(bytes(12))
    assert [channel.frequency_hz for channel in firmware.drive_log[-1].channels] == pytest.approx([1.0, 655.0])
    assert host.ask(Arm(firmware.configuration.boot_id, 100, 40, 0, (32_768,) * 2)) is Result.OK
    assert firmware.drive_log[-1].slew_per_s == 1000
    host.set(DRIVE)
    assert firmware.drive_log[-1].slew_per_s == 100
    assert [channel.amplitude for channel in firmware.drive_log[-1].channels] == pytest.approx([0.5, 0.5], abs=1e-4)


def test_a_frame_that_can_be_no_copy_is_fresh_whatever_its_number() -> None:
    """A copy can pass the clock for two leases."""
    host, firmware = greeted()
    assert host.arm() is Result.OK
    applied_us = host.set(DRIVE).applied_time_us
    for after_us, outcome in ((80_000, Outcome.STALE), (80_001, Outcome.ACCEPTED)):
        host.sequence -= 2
        host.tier.wait(applied_us + after_us - host.device_us())
        host.send(host.set_message(DRIVE))
        assert firmware.received[-1].outcome is outcome


def test_the_numbers_of_frames_and_of_samples_begin_again_where_their_fields_end() -> None:
    sent = deque[Acceleration](maxlen=2)
    reports = cast("Reports", SimpleNamespace(send=sent.append))  # a device would encode them all
    stream = Accelerations(Device(DeviceConfiguration(BOOT_ID)), reports)
    for number in range(2**16 + 1):
        stream.end_us = 0
        stream.take_sample(0, [0, 0], 3 * 2**31 + number)
        stream.end()
    assert [(each.frame, each.number, each.synthesis_sample) for each in sent] == [
        (2**16 - 1, 2**16 - 1, 2**31 + 2**16 - 1),
        (0, 2**16, 2**31 + 2**16),
    ]


def test_a_board_that_cannot_be_is_refused() -> None:
    with pytest.raises(ValueError, match="3 full scales for 2 actuators"):
        DeviceConfiguration(BOOT_ID, full_scales_pm=(1, 2, 3))
    with pytest.raises(ValueError, match="number_of_actuators is 0"):
        DeviceConfiguration(BOOT_ID, 0)
