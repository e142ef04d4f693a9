"""Laws of the faulty device: reboots, hang-ups and drift happen when they are due, and are counted."""

import pytest

from firmware_link.emulator.device_state import DeviceConfiguration
from firmware_link.emulator.fault_plan import parse_fault_plan
from firmware_link.emulator.faulty_device import AT_NOISE, FaultyDevice
from firmware_link.emulator.firmware import EmulatedFirmware
from firmware_link.protocol.framing import encode_message
from firmware_link.protocol.messages import Arm, DeviceState, FaultCode, Hello, Status, Time, TimeRequest
from tests.firmware_link.law_host import greeting
from tests.firmware_link.virtual_rig import decode_messages

SECOND_US = 1_000_000
GREETING = encode_message(greeting(), 1)


def device_with(text: str, seed: int = 1) -> FaultyDevice[EmulatedFirmware]:
    return FaultyDevice(lambda boot_id: EmulatedFirmware(DeviceConfiguration(boot_id)), parse_fault_plan(text), seed)


def greet(device: FaultyDevice[EmulatedFirmware], now_us: int) -> Hello:
    said = decode_messages(device.receive(GREETING, now_us))
    return next(message for message in said if isinstance(message, Hello))


def arm(device: FaultyDevice[EmulatedFirmware], now_us: int) -> None:
    hello = greet(device, now_us)
    device.receive(encode_message(Arm(hello.boot_id, 200, 40, 0, (1, 1)), 2), now_us)
    assert device.core.state is DeviceState.ARMED


def test_a_reboot_is_another_boot_with_a_clock_from_zero_and_deaf_meanwhile() -> None:
    device = device_with("reboot=0.5s@2s")
    first = greet(device, 0)
    device.run_until(2_000_000)
    assert device.receive(GREETING, 2_200_000) == b""
    second = greet(device, 3_000_000)
    assert first.boot_id != second.boot_id
    said = decode_messages(device.receive(encode_message(TimeRequest(0), 1), 3_000_000))
    assert [each.device_received_us for each in said if isinstance(each, Time)] == [500_000]
    assert (device.counters.reboots, device.to_device.counters.lost) == (1, 1)
    assert [boot.booted_us for boot in device.boots] == [0, 2_500_000]


def test_a_hang_up_latches_an_armed_device_and_takes_the_port_away_for_a_while() -> None:
    device = device_with("hang_up=0.2s@0.1s")
    arm(device, 0)
    device.run_until(99_999)
    assert device.is_plugged
    assert device.run_until(100_000) == b""
    assert not device.is_plugged
    assert device.core.state is DeviceState.LATCHED
    device.run_until(300_000)
    assert device.is_plugged
    said = decode_messages(device.receive(encode_message(TimeRequest(0), 1), 310_000) + device.run_until(500_000))
    assert FaultCode.HUNG_UP in {message.fault for message in said if isinstance(message, Status)}


@pytest.mark.parametrize("ppm", [-200, 0, 173])
def test_the_clock_drifts_as_asked_and_its_own_deadlines_come_on_it(ppm: int) -> None:
    device = device_with(f"drift={ppm}ppm")
    arm(device, 12_345)
    while device.core.state is DeviceState.ARMED:
        deadline_us = device.next_deadline_us()
        assert deadline_us is not None
        device.run_until(deadline_us)
        latched_us = deadline_us
    assert latched_us - 12_345 == pytest.approx(250_000 * (1 - ppm * 1e-6), abs=2)
    said = decode_messages(device.receive(encode_message(TimeRequest(0), 1), 100 * SECOND_US))
    assert [each.device_received_us for each in said if isinstance(each, Time)] == [100 * (SECOND_US + ppm)]


def test_a_modem_prober_speaks_first_at_each_opening() -> None:
    device = device_with("at_noise")
    for opening in range(3):
        device.receive(b"\0" + GREETING, opening * SECOND_US)
        device.hang_up(opening * SECOND_US + 500_000)
        lost = device.to_host.counters.lost
        assert device.run_until(opening * SECOND_US + 900_000) == b"", "nobody hears a device whose port is closed"
        assert device.to_host.counters.lost == lost + 4
    counters = device.core.framing_counters
    assert counters.ok == 3
    assert counters.framing + counters.crc + counters.length == 3
    assert device.counters.at_noises == 3
    assert b"\0" not in AT_NOISE
