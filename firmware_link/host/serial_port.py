"""Ports of boards as descriptors that never block: the list of serial ports, one opened by name, and opened again.

A port that was lost is opened again by its stable name, with growing pauses.
"""

import contextlib
import errno
import grp
import os
import stat
import termios
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, Protocol, Self, TypeVar

import serial
from serial.tools import list_ports

from firmware_link import BIT_RATE_HZ
from firmware_link.host.emulator_registry import find_announced
from firmware_link.protocol.link_errors import LinkError, LinkLostError

READ_SIZE = 4096  # bytes read at once
_BY_ID = Path("/dev/serial/by-id")
_RULE_FILE = "/etc/udev/rules.d/70-tactable-port.rules"  # must sort before 73-seat-late.rules
NS_PER_MS = 1_000_000
FIRST_PAUSE_NS = 100 * NS_PER_MS  # a cable that slipped is back at once; looking for ports costs milliseconds
LONGEST_PAUSE_NS = 2_000 * NS_PER_MS  # what a user waits who plugs it in again later


@dataclass(frozen=True)
class PortDescription:
    """One port of this machine; `stable_id` is its by-id path, else its USB serial number, else its path.

    The stable id of an emulator is the link in its registry. Vendor and product are USB numbers, None elsewhere.
    """

    path: str
    stable_id: str
    description: str
    vendor_id: int | None = None
    product_id: int | None = None


def find_ports() -> tuple[PortDescription, ...]:
    """Every serial port of this machine, in the order of its path, then every running emulator."""
    by_id = {str(link.resolve()): str(link) for link in sorted(_BY_ID.iterdir())} if _BY_ID.is_dir() else {}
    real = (
        PortDescription(
            path=port.device,
            stable_id=by_id.get(port.device) or port.serial_number or port.device,
            description=port.description,
            vendor_id=port.vid,
            product_id=port.pid,
        )
        for port in sorted(list_ports.comports(), key=lambda port: port.device)
    )
    emulated = (
        PortDescription(found.port, str(found.link), f"emulated firmware, process {found.process_id} (SIMULATED)")
        for found in find_announced()
    )
    return (*real, *emulated)


def path_of(name: str) -> str:
    """Find the path of a port by its path or stable id; raises LinkError for a name that is neither."""
    for port in find_ports():
        if name in (port.stable_id, port.path):
            return port.path
    if name and Path(name).exists():
        return name
    raise LinkError(f"no serial port {name!r}: plug the device in, or choose one that `tactable list` shows")


class DescriptorPort:
    """An open descriptor to a board, a serial port or the socket to a card; any later failure is a LinkLostError."""

    def __init__(self, path: str, descriptor: int) -> None:
        self.path, self._descriptor = path, descriptor
        os.set_blocking(descriptor, False)

    def fileno(self) -> int:
        """The descriptor, to poll."""
        return self._descriptor

    def read(self) -> bytes:
        """Read what has come, perhaps nothing. Raises LinkLostError when the board is gone."""
        try:
            data = os.read(self._descriptor, READ_SIZE)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise self._gone(error) from error
        if not data:
            raise self._gone("hung up")
        return data

    def write(self, data: bytes) -> int:
        """Write what is taken; returns the number of bytes, perhaps 0. Raises LinkLostError when the board is gone."""
        try:
            return os.write(self._descriptor, data)
        except BlockingIOError:
            return 0
        except OSError as error:
            raise self._gone(error) from error

    def close(self) -> None:
        """Close the port; a second close does nothing."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
        self._descriptor = -1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *unused: object) -> None:
        self.close()

    def _gone(self, reason: object) -> LinkLostError:
        return LinkLostError(f"{self.path} is gone ({reason}): plug the device in and connect again")


class SerialPort(DescriptorPort):
    """An open port: reads and writes what is possible at once; any failure is a LinkLostError, as after an unplug."""

    notes: tuple[str, ...] = ()  # what a user should know of the port, one sentence each

    def __init__(self, name: str, bit_rate_hz: int = BIT_RATE_HZ) -> None:
        self.path = path_of(name)
        self.bit_rate_hz = bit_rate_hz
        try:
            # pyserial only finds, opens and configures: its own write() busy-waits while the line is full.
            self._serial = serial.Serial(self.path, bit_rate_hz, timeout=0, exclusive=True)
        except (OSError, ValueError, termios.error) as error:
            is_refused = isinstance(error, OSError) and error.errno in (errno.EACCES, errno.EPERM)
            remedy = f"; to get {self.path}, {permission_remedy(self.path)}" if is_refused else ""
            raise LinkError(f"cannot open {self.path} at {bit_rate_hz} bit/s: {error}{remedy}") from error
        try:
            # Not to collect bytes: an FTDI does so for 16 ms by default, and for 1 ms then.
            with contextlib.suppress(OSError, ValueError, RuntimeError):  # drivers and pyserial refuse in these ways
                self._serial.set_low_latency_mode(True)
            super().__init__(self.path, self._serial.fileno())
            _report_hang_up(self._descriptor)
        except (OSError, termios.error) as error:
            self._serial.close()
            raise LinkError(f"cannot configure {self.path}: {error}") from error

    def close(self) -> None:
        """Close the port; a second close does nothing."""
        self._serial.close()


def permission_remedy(path: str) -> str:
    """Advice that gives a user the port: the group that it belongs to, where that helps, or a udev rule."""
    rule = f'SUBSYSTEM=="tty", KERNEL=="{Path(path).resolve().name}", TAG+="uaccess"'
    by_rule = f"put this udev rule into {_RULE_FILE}, run `sudo udevadm control --reload` and plug it in again: {rule}"
    group = _group_with_access(path)
    if group is None:
        return by_rule
    return f"run `sudo usermod -aG {group} $USER` and log in again, or {by_rule}"


def _group_with_access(path: str) -> str | None:
    """Group whose members may read and write the port (dialout on Debian, uucp on Arch); None where only root may."""
    try:
        status = Path(path).stat()
        group = grp.getgrgid(status.st_gid).gr_name
    except (OSError, KeyError):  # unplugged since, or a number without a name
        return None
    may_use = stat.S_IRGRP | stat.S_IWGRP
    return group if status.st_mode & may_use == may_use and group != "root" else None


def _report_hang_up(descriptor: int) -> None:
    """Make an empty read mean a hang-up: with pyserial's VMIN = 0 it also means that nothing has come."""
    attributes = termios.tcgetattr(descriptor)
    attributes[6][termios.VMIN] = 1
    attributes[6][termios.VTIME] = 0
    termios.tcsetattr(descriptor, termios.TCSANOW, attributes)


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
