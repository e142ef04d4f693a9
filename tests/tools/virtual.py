"""Virtual time for tests: a clock, and a line with faults between a host and a device of the emulator's process.

Time stands still until a test, or a loop that waits on the clock, lets it pass. It then goes from one event to the
next: the clock asks whatever acts by itself when that is due, goes there, and lets everything act. So a run takes the
same course on every machine, and none of it can be late.

The device is the emulator's own: `DeviceServer` steps it, as its process does behind a pseudo-terminal, and its faults
(loss, delay, noise, reboots, hang-ups) are those of `tactable emulate --faults`. The terminal alone is made here.
"""

from __future__ import annotations

import select
from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from firmware_link.emulator.device_server import DeviceServer
from firmware_link.emulator.device_state import DeviceConfiguration
from firmware_link.emulator.drive_log import DriveEvent
from firmware_link.emulator.fault_plan import parse_fault_plan
from firmware_link.emulator.faulty_device import Boot, FaultyDevice
from firmware_link.emulator.firmware import EmulatedFirmware
from firmware_link.protocol.link_errors import LinkError, LinkLostError

MS = 1_000_000
PORT = -1
"""Stands in for the port's descriptor; those of others are smaller."""
PASS_NS = 10_000
_LONGEST_NS = 1_000 * MS


class Actor(Protocol):
    """Acts by itself."""

    def next_ns(self) -> int | None:
        """When it acts next; None while it waits for others."""

    def act(self, now_ns: int) -> None:
        """Do what is due."""


class VirtualClock:
    """Time, and all that acts by itself."""

    def __init__(self, time_ns: int = 5_000 * MS) -> None:
        self.time_ns = time_ns
        self.actors: list[Actor] = []

    def now_ns(self) -> int:
        return self.time_ns

    def advance(self, end_ns: int) -> None:
        """To the next event, at most until `end_ns`, but a nanosecond at least."""
        due_ns = (actor.next_ns() for actor in self.actors)
        next_ns = min((each for each in due_ns if each is not None), default=end_ns)
        self.time_ns = max(self.time_ns + 1, min(end_ns, next_ns))
        for actor in self.actors:
            actor.act(self.time_ns)

    def run_to(self, end_ns: int) -> None:
        while self.time_ns < end_ns:
            self.advance(end_ns)

    def wait(self, until_ns: int | None, readable: Sequence[int], writable: Sequence[int]) -> Sequence[int]:
        """As a loop waits, on pipes and sockets that this process has both ends of; a pass takes PASS_NS."""
        end_ns = self.time_ns + _LONGEST_NS if until_ns is None else until_ns
        self.run_to(self.time_ns + PASS_NS)
        while True:
            found, free, _ = select.select(readable, writable, (), 0)
            if found or free or self.time_ns >= end_ns:
                return found
            self.advance(end_ns)

    def run_until(self, condition: Callable[[], object], limit_ns: int = 60_000 * MS) -> None:
        """From event to event until it holds; fails where it does not within the limit."""
        end_ns = self.time_ns + limit_ns
        while not condition():
            assert self.time_ns < end_ns, "it does not come to pass"
            self.advance(end_ns)


class _Terminal:
    """One life of the line's terminal: from a plug to the next."""

    def __init__(self, line: VirtualLine) -> None:
        self.name = "virtual"
        self.is_plugged, self.is_open = True, False
        self.to_device: list[tuple[int, bytes]] = []
        self.to_host: list[tuple[int, bytes]] = []
        self._line, self._has_host = line, False

    def has_host(self) -> bool:
        self._has_host |= self.is_open
        return self._has_host

    def read(self) -> bytes | None:
        data = arrived(self.to_device, self._line.time_ns)
        if data or self.is_open or self.to_device:
            return data
        self._has_host = False
        return None

    def write(self, data: bytes) -> int:
        if data and not self._line.is_mute:
            self.to_host.append((self._line.time_ns + self._line.delay_ns, data))
        return len(data)

    def close(self) -> None:
        self.is_plugged = False


def arrived(queue: list[tuple[int, bytes]], now_ns: int) -> bytes:
    """Take what has come until now."""
    number = next((at for at, (time_ns, _) in enumerate(queue) if time_ns > now_ns), len(queue))
    data = b"".join(data for _, data in queue[:number])
    del queue[:number]
    return data


@dataclass
class VirtualLine:
    """The host's end of a line to an emulated device: its port, opened already, and the clock that it waits on.

    What is written in either direction takes `delay_ns`. `faults` is a text for `parse_fault_plan`.
    """

    configuration: DeviceConfiguration = field(default_factory=lambda: DeviceConfiguration(0))
    faults: str = ""
    delay_ns: int = 300_000
    booted_ns: int = 0
    """When the device started."""
    clock: VirtualClock = field(default_factory=VirtualClock)
    loses: Callable[[int], bool] = lambda _: False
    """Whether the device never gets a write of the host, by its number; the first is 1."""
    takes_bytes: bool = True
    is_mute: bool = False
    loses_power: bool = False
    """With the cable."""
    wakes_every_ns: int = _LONGEST_NS
    """Waits are no longer: where something else than the device is looked for."""

    def __post_init__(self) -> None:
        self.written: list[tuple[int, bytes]] = []
        self.openings_ns: list[int] = []
        self.waits = 0
        self.stall_at_ns: int | None = None
        self.stall_ns = 400 * MS
        self.cable_pulled_ns: int | None = None
        self.cable_back_ns = 0
        device: FaultyDevice[Any] = FaultyDevice(self.start, parse_fault_plan(self.faults), 0)
        self.server = DeviceServer(device, lambda: _Terminal(self), self.booted_ns)
        self.clock.actors.append(self)
        self._terminal: _Terminal | None = None
        self.open()
        self.openings_ns.clear()

    def start(self, boot_id: int) -> Any:
        """The device of another boot; what it can do is for its test to know."""
        return EmulatedFirmware(replace(self.configuration, boot_id=boot_id))

    # ---- the device ----

    @property
    def firmware(self) -> Any:
        """The device of the present boot."""
        return self.server.device.core

    @firmware.setter
    def firmware(self, other: Any) -> None:
        self.server.device.boots.append(Boot(self.device_us(), other))

    def device_us(self) -> int:
        """The device's own time."""
        return (self.time_ns - self.server.host_ns_at_zero) // 1_000 - self.server.device.boots[-1].booted_us

    @property
    def log(self) -> list[DriveEvent]:
        """What the device drove in all its boots."""
        return [event for boot in self.server.device.boots for event in boot.core.drive_log]

    # ---- time ----

    @property
    def time_ns(self) -> int:
        return self.clock.time_ns

    def now_ns(self) -> int:
        return self.clock.time_ns

    def wait(self, until_ns: int | None, readable: Sequence[int], writable: Sequence[int]) -> Container[int] | None:
        """Until something has come for the host, as a loop waits; a stall holds the host up here."""
        assert (PORT in readable) == self.is_open and (not writable or PORT in readable)
        self.waits += 1
        if self.stall_at_ns is not None and self.time_ns >= self.stall_at_ns:
            self.stall()
        longest_ns = self.time_ns + self.wakes_every_ns
        self._wait_until(longest_ns if until_ns is None else min(until_ns, longest_ns))
        return None

    def stall(self) -> None:
        """The host stands still."""
        self.stall_at_ns = None
        self.clock.run_to(self.time_ns + self.stall_ns)

    def is_readable(self) -> bool:
        terminal = self._terminal
        if terminal is None:
            return False
        return not terminal.is_plugged or any(time_ns <= self.time_ns for time_ns, _ in terminal.to_host)

    def _wait_until(self, end_ns: int) -> None:
        while self.time_ns < end_ns and not self.is_readable():
            self.clock.advance(end_ns)

    def next_ns(self) -> int | None:
        terminal = self._terminal
        times_ns = [self.server.next_ns(), self.cable_pulled_ns]
        if terminal is not None:
            # What has come, and is not read, wakes nothing up again.
            times_ns += [time_ns for time_ns, _ in (*terminal.to_device, *terminal.to_host) if time_ns > self.time_ns]
        return min((time_ns for time_ns in times_ns if time_ns is not None), default=None)

    def act(self, now_ns: int) -> None:
        self.server.step(now_ns)
        if self.cable_pulled_ns is not None and now_ns >= self.cable_pulled_ns:
            self.cable_pulled_ns = None
            self.unplug(self.cable_back_ns - now_ns)

    def unplug(self, duration_ns: int) -> None:
        self.server.unplug(self.time_ns, duration_ns // 1_000)
        if self.loses_power:
            self.server.reboot(self.time_ns)

    # ---- the port ----

    @property
    def is_open(self) -> bool:
        return self._terminal is not None

    def open(self) -> VirtualLine:
        self.openings_ns.append(self.time_ns)
        terminal = self.server.terminal
        if terminal is None:
            raise LinkError("no serial port 'bar'")
        self._terminal, terminal.is_open = terminal, True
        return self

    def close(self) -> None:
        if self._terminal is not None:
            self._terminal.is_open, self._terminal = False, None
            self.server.step(self.time_ns)

    def fileno(self) -> int:
        return PORT

    def write(self, data: bytes) -> int:
        terminal = self._plugged()
        if not self.takes_bytes:
            return 0
        self.written.append((self.time_ns, data))
        if not self.loses(len(self.written)):
            terminal.to_device.append((self.time_ns + self.delay_ns, data))
        if not self.delay_ns:
            self.server.step(self.time_ns)
        return len(data)

    def read(self) -> bytes:
        return arrived(self._plugged().to_host, self.time_ns)

    def _plugged(self) -> _Terminal:
        assert self._terminal is not None
        if not self._terminal.is_plugged:
            raise LinkLostError("bar is gone")
        return self._terminal
