"""Laws of a device on its terminal, in virtual time: boots and faults are told, and a host that fails is not felt."""

import json
from collections.abc import Callable

import numpy as np
import pytest

from firmware_link.emulator.drive_log import Cause
from firmware_link.emulator.emulator_process import EmulatorLog, decode_log
from firmware_link.emulator.synthesis import synthesise
from firmware_link.protocol.drive_words import ChannelDrive, encode_drive
from firmware_link.protocol.framing import encode_message
from firmware_link.protocol.messages import DeviceState, FaultCode, Status, TimeRequest
from tests.firmware_link.law_host import DISARM_US, RAMP_US
from tests.firmware_link.strategies import RESOLUTION_HZ
from tests.firmware_link.virtual_rig import VirtualRig, decode_messages
from tests.tools.virtual import MS, VirtualLine

LEASE_US = 40_000
SAMPLE_RATE_HZ = 50_000.0


def log_of(line: VirtualLine) -> EmulatorLog:
    """As the parent of the emulator's process gets it."""
    return decode_log(json.loads(json.dumps(line.server.log())))


def test_a_reboot_begins_another_log_and_keeps_the_one_before() -> None:
    rig = VirtualRig()
    for _ in range(2):
        rig.connect()
        rig.run(3 * MS)
        rig.line.server.reboot(rig.now_ns)
    log = log_of(rig.line)
    assert [bool(boot.received) for boot in (*log.earlier, log)] == [True, True, False]
    assert log.faults["reboots"] == 2
    starts_ns = [boot.host_ns_at_device_zero for boot in (*log.earlier, log)]
    assert starts_ns == sorted(set(starts_ns)) and starts_ns[0] == rig.device_start_ns


def test_faults_are_injected_and_counted() -> None:
    rig = VirtualRig(faults="duplicate=1")
    rig.connect()
    log = log_of(rig.line)
    assert log.faults["to_device.duplicated"] == log.faults["to_device.frames"] >= 6
    assert log.counters["ok"] == log.faults["to_device.intact"]


def silent_from_us(log: EmulatorLog) -> float:
    """Device time from which every actuator stays at zero."""
    start_us = log.events[-1].device_time_us - 50_000
    moves = np.abs(synthesise(log.events, start_us, start_us + 150_000, SAMPLE_RATE_HZ)).max(axis=1)
    return float(start_us + (np.flatnonzero(moves)[-1] + 1) * 1e6 / SAMPLE_RATE_HZ)


def told_at_the_next_opening(rig: VirtualRig) -> tuple[DeviceState, FaultCode]:
    """State and fault, by the device's last status; nothing greets it, which would release it."""
    rig.line.open()
    rig.line.read()
    rig.line.write(encode_message(TimeRequest(0), 0))
    rig.line.clock.run_to(rig.now_ns + 500 * MS)
    *_, status = (message for message in decode_messages(rig.line.read()) if isinstance(message, Status))
    return status.state, status.fault


def fall_silent(rig: VirtualRig) -> None:
    """Stopped, wedged or in an endless loop: the port stays open."""


@pytest.mark.parametrize(
    ("fail", "cause", "fault"),
    [
        (lambda rig: rig.line.close(), Cause.HUNG_UP, FaultCode.HUNG_UP),
        (lambda rig: rig.line.unplug(300 * MS), Cause.HUNG_UP, FaultCode.HUNG_UP),
        (fall_silent, Cause.LEASE_EXPIRED, FaultCode.SILENT_HOST),
    ],
    ids=["closed", "unplugged", "silent"],
)
@pytest.mark.parametrize("delay_ns", [0, 300_000, 30 * MS])
def test_a_host_that_fails_leaves_no_drive(
    fail: Callable[[VirtualRig], None], cause: Cause, fault: FaultCode, delay_ns: int
) -> None:
    rig = VirtualRig(delay_ns=delay_ns)
    rig.connect()
    rig.link.set_drive(encode_drive([ChannelDrive(200, 1.0)] * 2, RESOLUTION_HZ))
    rig.run(123 * MS)
    failed_us, rig.is_host_alive = rig.line.device_us(), False
    fail(rig)
    rig.run(2 * DISARM_US * 1_000)
    log = log_of(rig.line)
    last_us = max(frame.device_time_us for frame in log.received if frame.message == "SET")
    # What is on the line when the host fails may be as old as a lease when it is applied.
    assert last_us <= failed_us + LEASE_US
    assert log.events[-1].cause is cause
    assert silent_from_us(log) <= last_us + LEASE_US + RAMP_US
    assert told_at_the_next_opening(rig) == (DeviceState.LATCHED, fault)
