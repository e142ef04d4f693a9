"""Pseudo-terminal as the terminal of a `DeviceServer`, and the poll loop that serves it on the monotonic clock."""

import os
import select
import time
from collections.abc import Callable, Sequence

from firmware_link.emulator.device_server import DeviceServer
from firmware_link.emulator.faulty_device import C
from firmware_link.protocol.link_errors import LinkError

NS_PER_MS = 1_000_000
READ_SIZE = 4096  # N_TTY_BUF_SIZE of Linux: one read takes what waits
HOST_POLL_MS = 10  # how often to look whether a host has opened the terminal: nothing wakes a poll for that


def open_pseudo_terminal(
    open_pair: Callable[[], tuple[int, int]] | None = None, name_of: Callable[[int], str] = os.ttyname
) -> tuple[int, int, str]:
    """Both sides of a new pseudo-terminal, and the name of the second. Raises LinkError where the system has none."""
    try:
        master, slave = (open_pair or os.openpty)()
    except OSError as error:
        raise LinkError(
            f"/dev/ptmx: no pseudo-terminal can be opened ({error.strerror}): in a container or chroot mount devpts on "
            "/dev/pts; else end programs that have many terminals"
        ) from error
    try:
        return master, slave, name_of(slave)
    except OSError as error:
        os.close(master)
        os.close(slave)
        raise LinkError(
            f"/dev/pts: the name of a pseudo-terminal is not there ({error.strerror}): mount devpts on /dev/pts"
        ) from error


class PseudoTerminal:
    """The master side of a new pseudo-terminal; `name` is that of the other side."""

    def __init__(self) -> None:
        self._master, slave, self.name = open_pseudo_terminal()
        os.set_blocking(self._master, False)
        os.close(slave)
        self._has_host = False

    def fileno(self) -> int:
        """The descriptor, to poll while there is a host: without one, poll reports a hang-up without end."""
        return self._master

    def has_host(self) -> bool:
        """Whether a host has opened it, or has left something to read."""
        if not self._has_host:
            probe = select.poll()
            probe.register(self._master, select.POLLIN)
            events = dict(probe.poll(0)).get(self._master, 0)
            self._has_host = not events & select.POLLHUP or bool(events & select.POLLIN)
        return self._has_host

    def read(self) -> bytes | None:
        """What hosts have written, perhaps nothing; None once the last host has closed it."""
        try:
            return os.read(self._master, READ_SIZE)
        except BlockingIOError:
            return b""
        except OSError:
            self._has_host = False
            return None

    def write(self, data: bytes) -> int:
        """Write what is taken; returns the number of bytes, perhaps 0."""
        try:
            return os.write(self._master, data)
        except OSError:  # full, or closed since: the next read tells
            return 0

    def close(self) -> None:
        """Pull the cable."""
        os.close(self._master)


def serve(server: DeviceServer[C, PseudoTerminal], end_descriptors: Sequence[int]) -> int:
    """Serve until one of the descriptors has something to read, or has closed; returns that descriptor."""
    poll = select.poll()
    for descriptor in end_descriptors:
        poll.register(descriptor, select.POLLIN)
    while True:
        terminal = server.terminal
        watched = terminal if terminal is not None and terminal.has_host() else None
        if watched is not None:
            poll.register(watched, select.POLLIN | (select.POLLOUT if server.wants_to_write() else 0))
        ready = dict(poll.poll(_timeout_ms(server, looks_for_host=terminal is not watched)))
        if watched is not None:
            poll.unregister(watched)
        ended = set(ready).intersection(end_descriptors)
        if ended:
            return ended.pop()
        server.step(time.monotonic_ns())


def _timeout_ms(server: DeviceServer[C, PseudoTerminal], *, looks_for_host: bool) -> int | None:
    due_ns = server.next_ns()
    until_ms = None if due_ns is None else max(0, -((time.monotonic_ns() - due_ns) // NS_PER_MS))
    if not looks_for_host:
        return until_ms
    return HOST_POLL_MS if until_ms is None else min(until_ms, HOST_POLL_MS)
