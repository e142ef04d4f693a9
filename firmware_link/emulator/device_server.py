"""One device on its terminals: each step moves the bytes of both sides and follows the plug. Time is an argument."""

from collections.abc import Callable
from dataclasses import asdict
from typing import Any, Generic, Protocol, TypeVar

from firmware_link.emulator.drive_log import encode_events
from firmware_link.emulator.faulty_device import Boot, C, FaultyDevice
from firmware_link.emulator.firmware import EmulatedFirmware

NS_PER_US = 1_000
UNSENT_LIMIT = 8192  # a host that does not read loses what the device says, as on a wire


class Terminal(Protocol):
    """The device's end of a serial line; its other end has a name by which hosts open it."""

    name: str

    def has_host(self) -> bool:
        """Whether a host has opened it, or has left something to read."""

    def read(self) -> bytes | None:
        """What hosts have written, perhaps nothing; None once the last host has closed it."""

    def write(self, data: bytes) -> int:
        """Write what is taken; returns the number of bytes, perhaps 0."""

    def close(self) -> None:
        """Pull the cable: hosts lose the line."""


T = TypeVar("T", bound=Terminal)


class DeviceServer(Generic[C, T]):
    """Serves one device on a terminal, and on another one whenever the port was unplugged.

    `on_port` is told the name of each terminal, and `on_gone` that it goes, before it does, since its name may belong
    to somebody else at once. The device's line starts at `start_ns`; the caller owns the clock.
    """

    def __init__(
        self,
        device: FaultyDevice[C],
        open_terminal: Callable[[], T],
        start_ns: int,
        on_port: Callable[[str], None] = lambda _: None,
        on_gone: Callable[[], None] = lambda: None,
    ) -> None:
        self.device, self.host_ns_at_zero = device, start_ns
        self.terminal: T | None = open_terminal()
        self._open_terminal, self._on_port, self._on_gone = open_terminal, on_port, on_gone
        self._next: T | None = None
        self._unsent = b""
        on_port(self.terminal.name)

    def step(self, now_ns: int) -> None:
        """Take what hosts have written, let time pass, and say what the device says until then."""
        now_us, terminal = self._us(now_ns), self.terminal
        data = terminal.read() if terminal is not None and terminal.has_host() else b""
        if data is None:
            self._unsent = b""
            self.device.hang_up(now_us)
        else:
            self._say(self.device.receive(data, now_us) if data else self.device.run_until(now_us))
        self._follow_plug()

    def next_ns(self) -> int | None:
        """Time at which the device acts by itself next; None while it waits."""
        deadline_us = self.device.next_deadline_us()
        return None if deadline_us is None else self.host_ns_at_zero + deadline_us * NS_PER_US

    def wants_to_write(self) -> bool:
        """Whether a host has not taken all yet."""
        return bool(self._unsent)

    def unplug(self, now_ns: int, duration_us: int) -> None:
        """Pull the cable for a while: the port comes back under another name."""
        self.device.unplug(self._us(now_ns), duration_us)
        self._follow_plug()

    def reboot(self, now_ns: int) -> None:
        """Power the device off and on."""
        self.device.reboot(self._us(now_ns))

    def close(self) -> None:
        """Close the terminals."""
        self._on_gone()
        for terminal in (self.terminal, self._next):
            if terminal is not None:
                terminal.close()

    def log(self: "DeviceServer[EmulatedFirmware, T]") -> dict[str, Any]:
        """Actions of the device as JSON, from which `EmulatorLog` is made."""
        return {
            "simulated": True,
            "number_of_actuators": self.device.core.configuration.number_of_actuators,
            "boots": [self._boot_log(boot) for boot in self.device.boots],
            "faults": self.device.fault_counts(),
        }

    def take_events(self: "DeviceServer[EmulatedFirmware, T]", now_ns: int) -> dict[str, Any]:
        """The drive events since the last call as JSON, which the device forgets, and the time until which they are."""
        core = self.device.core
        events = encode_events(core.drive_log)
        core.drive_log.clear()
        core.received.clear()
        return {"until_us": self._us(now_ns), "host_ns_at_device_zero": self.host_ns_at_zero, "events": events}

    def _boot_log(self, boot: Boot[EmulatedFirmware]) -> dict[str, Any]:
        firmware = boot.core
        return {
            "host_ns_at_device_zero": self.host_ns_at_zero + boot.booted_us * NS_PER_US,
            "events": encode_events(firmware.drive_log),
            "received": encode_events(firmware.received),
            "counters": asdict(firmware.counters) | asdict(firmware.framing_counters),
        }

    def _us(self, now_ns: int) -> int:
        return (now_ns - self.host_ns_at_zero) // NS_PER_US

    def _say(self, data: bytes) -> None:
        terminal = self.terminal
        if terminal is None or not terminal.has_host():
            self._unsent = b""
            return
        if len(self._unsent) + len(data) <= UNSENT_LIMIT:
            self._unsent += data
        if self._unsent:
            self._unsent = self._unsent[terminal.write(self._unsent) :]

    def _follow_plug(self) -> None:
        if self.device.is_plugged and self.terminal is None:
            self.terminal, self._next = self._next or self._open_terminal(), None
            self._on_port(self.terminal.name)
        elif not self.device.is_plugged and self.terminal is not None:
            # Opened while the old name is still taken: the port comes back under another.
            self._next = self._open_terminal()
            self._on_gone()
            self.terminal.close()
            self.terminal, self._unsent = None, b""
