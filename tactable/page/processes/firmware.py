"""Child process that emulates the firmware for the page, and answers questions with new drive events. SIMULATED.

Unlike `firmware_link.emulator.process` it forgets what it has answered, since it runs for hours.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from base.child import Parent
from firmware_link.emulator import DeviceConfiguration, DriveEvent, EmulatedFirmware
from firmware_link.emulator.device_server import DeviceServer
from firmware_link.emulator.drive_log import decode_drive_event, encode_events
from firmware_link.emulator.fault_plan import parse_fault_plan
from firmware_link.emulator.faulty_device import FaultyDevice
from firmware_link.emulator.pty import PseudoTerminal, serve

_NS_PER_US = 1000


@dataclass(frozen=True)
class Applied:
    """The drive events since the last question; every event is before `until_us`."""

    until_us: float
    host_ns_at_device_zero: int
    events: tuple[DriveEvent, ...]


def decode_applied(document: Mapping[str, Any]) -> Applied:
    """An answer of the process."""
    return Applied(
        until_us=document["until_us"],
        host_ns_at_device_zero=document["host_ns_at_device_zero"],
        events=tuple(decode_drive_event(item) for item in document["events"]),
    )


class _Reporter:
    """Answers with what happened since the last answer; the device forgets what was answered."""

    def __init__(self, server: DeviceServer[EmulatedFirmware, PseudoTerminal]) -> None:
        self._server = server

    def report(self, now_us: int) -> dict[str, Any]:
        """The drive events since the last report."""
        server, core = self._server, self._server.device.core
        events = encode_events(core.drive_log)
        core.drive_log.clear()
        core.received.clear()
        return {
            "until_us": now_us,
            "host_ns_at_device_zero": server.host_ns_at_zero,
            "events": events,
        }


def main(parent: Parent, arguments: dict[str, Any]) -> None:
    """Say the port, then answer each line of the page, until it asks for the end."""
    configuration = DeviceConfiguration(**{**arguments, "full_scales_pm": tuple(arguments["full_scales_pm"])})
    device = FaultyDevice(
        lambda boot_id: EmulatedFirmware(replace(configuration, boot_id=boot_id)), parse_fault_plan(""), 0
    )
    server = DeviceServer(device, PseudoTerminal, time.monotonic_ns())
    assert server.terminal is not None
    reporter = _Reporter(server)
    parent.say({"port": server.terminal.name})
    while serve(server, [parent.fileno()]) is not None and parent.read() is not None:
        now_us = (time.monotonic_ns() - server.host_ns_at_zero) // _NS_PER_US
        parent.say(reporter.report(now_us))
    server.close()
