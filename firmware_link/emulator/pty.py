"""Server of an emulated device on a pseudo-terminal: one poll loop on the monotonic clock."""

import contextlib
import os
import select
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any, Generic

from firmware_link.emulator.drive_log import encode_events
from firmware_link.emulator.faulty_device import Boot, C, FaultyDevice
from firmware_link.emulator.firmware import EmulatedFirmware

NS_PER_US = 1_000
US_PER_MS = 1_000
# A host that does not read loses what the device says, as on a wire.
UNSENT_LIMIT = 8192
READ_SIZE = 4096
# How often to look whether a host has opened the terminal: nothing wakes a poll for that.
HOST_POLL_MS = 10


class PseudoTerminalServer(Generic[C]):
    """Serves one device on a pseudo-terminal with one poll loop and the monotonic clock.

    `on_port` is told the name of each terminal: a new one whenever the port was unplugged. `on_gone` is told before the
    terminal goes, since its name may belong to somebody else at once.
    """

    def __init__(
        self, device: FaultyDevice[C], on_port: Callable[[str], None], on_gone: Callable[[], None] = lambda: None
    ) -> None:
        self.device = device
        self.path = ""
        self.host_ns_at_zero = time.monotonic_ns()
        self._on_port, self._on_gone = on_port, on_gone
        self._master: int | None = None
        self._next: tuple[int, str] | None = None
        self._has_host = False
        self._unsent = b""
        self._plug()

    def serve(self, end_descriptors: Sequence[int]) -> int:
        """Serve until one of the descriptors has something to read, or has closed; returns that descriptor."""
        poll = select.poll()
        for descriptor in end_descriptors:
            poll.register(descriptor, select.POLLIN)
        while True:
            watched = self._watched()
            if watched is not None:
                poll.register(watched, select.POLLIN | (select.POLLOUT if self._unsent else 0))
            ready = dict(poll.poll(self._timeout_ms()))
            if watched is not None:
                poll.unregister(watched)
            ended = set(ready).intersection(end_descriptors)
            if ended:
                return ended.pop()
            self._send(self._receive() if watched in ready else self.device.advance(self._now_us()))
            self._follow_plug()

    def close(self) -> None:
        """Close the terminal."""
        self._let_go()
        if self._next is not None:
            os.close(self._next[0])

    def log(self: "PseudoTerminalServer[EmulatedFirmware]") -> dict[str, Any]:
        """What the device did, for JSON: `EmulatorLog` is made of it."""
        return {
            "simulated": True,
            "number_of_actuators": self.device.core.configuration.number_of_actuators,
            "boots": [self._boot_log(boot) for boot in self.device.boots],
            "faults": self.device.fault_counts(),
        }

    def unplug(self, duration_us: int) -> None:
        """Pull the cable for a while: the port comes back under another name."""
        self.device.unplug(self._now_us(), duration_us)
        self._follow_plug()

    def reboot(self) -> None:
        """Power the device off and on."""
        self.device.reboot(self._now_us())

    def _boot_log(self, boot: Boot[EmulatedFirmware]) -> dict[str, Any]:
        firmware = boot.core
        return {
            "host_ns_at_device_zero": self.host_ns_at_zero + boot.booted_us * NS_PER_US,
            "events": encode_events(firmware.drive_log),
            "received": encode_events(firmware.received),
            "counters": asdict(firmware.counters) | asdict(firmware.framing_counters),
        }

    def _watched(self) -> int | None:
        """The terminal, while a host has it open: for one that is not open, poll reports a hang-up without end."""
        if self._master is not None and not self._has_host:
            probe = select.poll()
            probe.register(self._master, select.POLLIN)
            events = dict(probe.poll(0)).get(self._master, 0)
            self._has_host = not events & select.POLLHUP or bool(events & select.POLLIN)
        return self._master if self._has_host else None

    def _now_us(self) -> int:
        return (time.monotonic_ns() - self.host_ns_at_zero) // NS_PER_US

    def _timeout_ms(self) -> int | None:
        deadline_us = self.device.next_deadline_us()
        until_ms = None if deadline_us is None else max(0, -((self._now_us() - deadline_us) // US_PER_MS))
        if self._has_host or self._master is None:
            return until_ms
        return HOST_POLL_MS if until_ms is None else min(until_ms, HOST_POLL_MS)

    def _receive(self) -> bytes:
        assert self._master is not None
        try:
            data = os.read(self._master, READ_SIZE)
        except BlockingIOError:
            data = b""
        except OSError:  # the last host has closed the terminal
            self._has_host, self._unsent = False, b""
            self.device.hang_up(self._now_us())
            return b""
        return self.device.receive(data, self._now_us())

    def _send(self, data: bytes) -> None:
        if not self._has_host or self._master is None:
            return
        if len(self._unsent) + len(data) <= UNSENT_LIMIT:
            self._unsent += data
        if self._unsent:
            with contextlib.suppress(OSError):  # full, or closed since: the next read tells
                self._unsent = self._unsent[os.write(self._master, self._unsent) :]

    def _follow_plug(self) -> None:
        if self.device.is_plugged and self._master is None:
            self._plug()
        elif not self.device.is_plugged and self._master is not None:
            self._unplug()

    def _plug(self) -> None:
        self._master, self.path = self._next or _open_terminal()
        self._next = None
        self._on_port(self.path)

    def _unplug(self) -> None:
        # Opened while the old name is still taken: the port comes back under another.
        self._next = _open_terminal()
        self._on_gone()
        self._let_go()

    def _let_go(self) -> None:
        if self._master is not None:
            os.close(self._master)
        self._master, self._has_host, self._unsent = None, False, b""


def _open_terminal() -> tuple[int, str]:
    """Open a new terminal; returns its master side and its name, with its other side closed."""
    master, slave = os.openpty()
    os.set_blocking(master, False)
    name = os.ttyname(slave)
    os.close(slave)
    return master, name
