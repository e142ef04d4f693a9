"""Session: a link on its port, one exchange a call, never blocking."""

from collections.abc import Callable
from typing import Protocol

from firmware_link.host.link import Link
from firmware_link.host.link_values import Event
from firmware_link.protocol.link_errors import LinkError


class Port(Protocol):
    """The port of a session: a `SerialPort`, or a socket pair in a measurement."""

    def fileno(self) -> int:
        """The descriptor, to poll."""

    def read(self) -> bytes:
        """Read what has come, perhaps nothing; raises LinkLostError when the port is gone."""

    def write(self, data: bytes) -> int:
        """Write what the port takes; returns the number of bytes, perhaps 0. Raises LinkLostError when it is gone."""


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

    def lose_port(self) -> None:
        """The port is gone, and what it did not take is never sent."""
        self._unsent = b""
        self.link.disconnect()

    def move_to(self, port: Port) -> None:
        """Start a new session on another port, or on the same one opened again."""
        self.port = port
        self.connect()

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
        """The first half of `exchange`: take in what has come.

        Only then is the device called silent: a host that stalled finds what it said in the meantime.
        """
        data = self.port.read()
        now_ns = self._monotonic_ns()
        events = self.link.receive(data, now_ns) if data else []
        self.link.poll(now_ns)
        return events

    def must_receive(self) -> bool:
        """Whether to `receive` although nothing had come when the loop woke up: only that calls a device silent.

        A host that stalled since then finds what the device said in the meantime.
        """
        return self.link.is_overdue(self._monotonic_ns())

    def send(self) -> None:
        """The second half of `exchange`: write what is due."""
        data = self._unsent or self.link.outgoing(self._monotonic_ns())
        if data:
            self._unsent = data[self.port.write(data) :]

    def wants_to_write(self) -> bool:
        """Whether the port should be polled for writing too."""
        return bool(self._unsent)
