"""A link on its port: one exchange a call, never blocking."""

from collections.abc import Callable
from typing import Protocol

from firmware_link.errors import LinkError
from firmware_link.link import Link
from firmware_link.link_values import Event


class Port(Protocol):
    """What a session needs of a port: `SerialPort` has it, and so may a socket pair in a measurement."""

    def fileno(self) -> int:
        """The descriptor, to poll."""

    def read(self) -> bytes:
        """What has come, perhaps nothing; raises LinkError when the port is gone."""

    def write(self, data: bytes) -> int:
        """Number of bytes taken, perhaps none; raises LinkError when the port is gone."""


class Session:
    """Moves bytes between a link and a port; what the port did not take goes first the next time."""

    def __init__(self, link: Link, port: Port, monotonic_ns: Callable[[], int]) -> None:
        self.link = link
        self.port = port
        self._monotonic_ns = monotonic_ns
        self._unsent = b""

    def connect(self) -> None:
        """Start a new session on the open port."""
        self._unsent = b""
        self.link.connect(self._monotonic_ns())

    def exchange(self) -> list[Event]:
        """Read, act, write; raises LinkError when the port is gone or the device does not do its part."""
        try:
            events = self.receive()
            self.send()
        except LinkError:
            self.link.disconnect()
            raise
        return events

    def receive(self) -> list[Event]:
        """The first half of `exchange`: take in what has come."""
        data = self.port.read()
        return self.link.receive(data, self._monotonic_ns()) if data else []

    def send(self) -> None:
        """The second half of `exchange`: write what is due."""
        now_ns = self._monotonic_ns()
        self.link.poll(now_ns)
        self._unsent = self._unsent or self.link.outgoing(now_ns)
        if self._unsent:
            self._unsent = self._unsent[self.port.write(self._unsent) :]

    def wants_to_write(self) -> bool:
        """Whether the port should be polled for writing too."""
        return bool(self._unsent)
