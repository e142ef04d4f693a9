"""Reconnection: a port that was lost is opened again by its stable name, with growing pauses."""

from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from firmware_link.host.serial_port import PortDescription, find_ports
from firmware_link.protocol.link_errors import LinkError

NS_PER_MS = 1_000_000
FIRST_PAUSE_NS = 100 * NS_PER_MS  # a cable that slipped is back at once; looking for ports costs milliseconds
LONGEST_PAUSE_NS = 2_000 * NS_PER_MS  # what a user waits who plugs it in again later


class Closable(Protocol):
    """A port that can be given back."""

    def close(self) -> None:
        """Close the port."""


P = TypeVar("P", bound=Closable)


class ReopeningPort(Generic[P]):
    """Opens one port again whenever it was lost; no I/O but by `open_port`, which raises LinkError.

    `port` is the one that is open already; without one, the first `poll` opens it.
    Nothing is sent by itself: a port that is open again needs `Session.connect`, the whole handshake, and whether to
    arm again is for the caller to decide.
    """

    def __init__(self, open_port: Callable[[], P], port: P | None = None) -> None:
        self.port = port
        self.attempts = 0  # how often opening has failed since the port was lost
        self.reason = ""  # why the last attempt was in vain
        self._open_port = open_port
        self._pause_ns = FIRST_PAUSE_NS
        self._due_ns = 0

    def close(self) -> None:
        """Close the port, if it is open."""
        if self.port is not None:
            self.port.close()
            self.port = None

    def lose(self, now_ns: int) -> None:
        """The port is gone: close what is left of it, and try again after the first pause."""
        self.close()
        self.attempts, self._pause_ns = 0, FIRST_PAUSE_NS
        self._due_ns = now_ns + FIRST_PAUSE_NS

    def poll(self, now_ns: int) -> P | None:
        """The port, opened now if it is time to try; None while it is gone."""
        if self.port is None and now_ns >= self._due_ns:
            try:
                self.port = self._open_port()
            except LinkError as error:
                self.attempts += 1
                self.reason = str(error)
                self._due_ns = now_ns + self._pause_ns
                self._pause_ns = min(2 * self._pause_ns, LONGEST_PAUSE_NS)
        return self.port

    def next_attempt_ns(self) -> int | None:
        """Time at which `poll` tries next; None while the port is open."""
        return self._due_ns if self.port is None else None


def stable_name_of(name: str, ports: Callable[[], tuple[PortDescription, ...]] = find_ports) -> str:
    """The name by which a port is found again under another path: its stable id, or the name itself."""
    return next((port.stable_id for port in ports() if name in (port.path, port.stable_id)), name)
