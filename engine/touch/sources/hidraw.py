"""Reads the reports of a HID digitizer of this machine, across unplugs and overflows."""

import errno
import fcntl
import os
import select
import struct
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path

from engine.touch.digitizer import DigitizerError
from engine.touch.sources import LIFT_ALL, OnClock
from engine.touch.sources.hid_discovery import HidDigitizer, HidSystem, find_digitizers, refusal, select_digitizer

RING_SIZE = 63  # unread reports that the kernel keeps; it then drops the newest
_READ_BYTES = 4096  # with a smaller buffer the rest of a report is lost
_FIRST_RETRY_NS = 250_000_000
_LAST_RETRY_NS = 2_000_000_000  # longest pause, as of a lost port (firmware_link/host/serial_port.py)
# _IOR('H', 1, int) and _IOR('H', 2, struct hidraw_report_descriptor) of linux/hidraw.h
_HIDIOCGRDESCSIZE, _HIDIOCGRDESC = 0x80044801, 0x90044802


class Connection(Enum):
    """Whether the device is there."""

    CONNECTED = "connected"
    LOST = "lost; looked for until it comes back"
    CLOSED = "closed"


@dataclass(slots=True)
class HidrawCounters:
    """Counts of events of the device. An overflow is a full kernel ring after a stall: reports were lost."""

    overflows: int = 0
    losses: int = 0
    reconnects: int = 0


class HidrawSource(OnClock):
    """A live digitizer as a Source; with `reconnect` an unplug is waited out, otherwise it ends the source.

    `state`, `problem` and `counters` say how it is. Raises `DigitizerError` when the device cannot be opened.

    What is lost when the ring overflows may hold a release, and a lost device has no fingers: LIFT_ALL stands for the
    report that is missing. A contact that is still there comes back with the next report that tells of it.
    """

    def __init__(self, system: HidSystem, device: HidDigitizer, *, reconnect: bool = True) -> None:
        self.counters = HidrawCounters()
        self.problem: DigitizerError | None = None  # why the device is not there; None while it is
        self.name, self.report_id = device.name, device.report_id
        self.vendor_id, self.product_id = device.vendor_id, device.product_id
        self._finder = _Finder(system, device)
        self._reconnects = reconnect
        self._poll = select.epoll()
        self._node: _Node | None = None
        self._burst = 0  # reports read since there was none
        try:
            self._attach(_Node(system, device))
        except DigitizerError:
            self.close()
            raise
        assert self._node is not None
        self.descriptor: bytes = self._node.descriptor

    @property
    def device(self) -> HidDigitizer:
        """The device, with the path that it had when it was opened last."""
        return self._finder.device

    @property
    def state(self) -> Connection:
        """Whether the device is there."""
        if self._node is not None:
            return Connection.CONNECTED
        return Connection.LOST if self._reconnects else Connection.CLOSED

    @property
    def ended(self) -> bool:
        """The device is gone and not looked for."""
        return self.state is Connection.CLOSED

    def fileno(self) -> int | None:
        """One number for the source's life, whatever node the device has; None once it is closed."""
        return None if self._poll.closed else self._poll.fileno()

    def next_time_ns(self) -> int | None:
        """Time at which to look for a lost device."""
        return self._finder.retry_ns if self.state is Connection.LOST else None

    def read(self, now_ns: int) -> bytes | None:
        """The next report that is there; a device that is gone has none until it comes back."""
        node = self._node or self._look_for_device(now_ns)
        if node is None:
            return None
        try:
            report = node.read()
        except OSError as error:
            self._lose(error, now_ns)
            return self._lift_all(now_ns) if self._reconnects else None
        if report is None:
            burst, self._burst = self._burst, 0
            if burst < RING_SIZE:
                return None
            self.counters.overflows += 1
            return self._lift_all(now_ns)
        self._count_report(now_ns)
        return report

    packet_head = 0

    def packet_fileno(self) -> int | None:
        """The node itself, each read of which is one report; None while it is lost."""
        return None if self._node is None else self._node.fileno()

    def take_packet(self, packet: bytes, now_ns: int, *, is_last: bool) -> bytes:
        """Take a report that the compiled wait read at `now_ns`; it may be the last available one."""
        self._count_report(now_ns)
        if is_last and self._burst < RING_SIZE:
            self._burst = 0
        return packet

    def _count_report(self, now_ns: int) -> None:
        self._burst += 1
        self.report_index += 1
        self.report_time_ns = now_ns

    def _lift_all(self, now_ns: int) -> bytes:
        self._count_report(now_ns)
        self._burst = 0
        return LIFT_ALL

    def close(self) -> None:
        """Give the device back; a second close does nothing."""
        self._reconnects = False
        if self._node is not None:
            self._node.close()
            self._node = None
        self._poll.close()

    def _attach(self, node: "_Node") -> None:
        self._poll.register(node.fileno(), select.EPOLLIN)
        self._node = node
        self.problem = None

    def _lose(self, error: OSError, now_ns: int) -> None:
        assert self._node is not None
        self._node.close()  # which also takes it out of the poll
        self._node = None
        self._burst = 0
        self.counters.losses += 1
        self.problem = refusal(self.device, error)
        self._finder.wait(now_ns, _FIRST_RETRY_NS)

    def _look_for_device(self, now_ns: int) -> "_Node | None":
        """Open the device under its present path; each attempt waits twice as long as the one before."""
        if not self._reconnects or now_ns < self._finder.retry_ns:
            return None
        try:
            node = self._finder.reopen(self.descriptor)
        except DigitizerError as error:
            self.problem = error
            self._finder.wait(now_ns, min(2 * self._finder.pause_ns, _LAST_RETRY_NS))
            return None
        self._attach(node)
        self.counters.reconnects += 1
        return node


class _Finder:
    """Finds a device again that was unplugged, and says when to look for it."""

    def __init__(self, system: HidSystem, device: HidDigitizer) -> None:
        self.system, self.device = system, device
        self.retry_ns = self.pause_ns = 0
        # Of two equal devices without serial numbers, the other one must not replace the lost one.
        self._others = {found.stable_id for found in find_digitizers(system)} - {device.stable_id}

    def wait(self, now_ns: int, pause_ns: int) -> None:
        """Look again after a pause."""
        self.pause_ns, self.retry_ns = pause_ns, now_ns + pause_ns

    def reopen(self, descriptor: bytes) -> "_Node":
        """Open the device again. Raises DigitizerError while it is away, or where its descriptor is another one."""
        mine = self.device

        def matches(found: HidDigitizer) -> bool:
            is_same = (found.number, found.serial_number) == (mine.number, mine.serial_number)
            return is_same and found.stable_id not in self._others

        def difference(found: HidDigitizer) -> tuple[bool, bool, bool]:
            # Of a composite device the same interface; of equal devices the same port, then the same path.
            is_other = found.interface_number != mine.interface_number
            return is_other, found.port != mine.port, found.path != mine.path

        nearest = min(filter(matches, find_digitizers(self.system)), key=difference, default=None)
        if nearest is None:
            raise DigitizerError(f"{mine.name or mine.number} is unplugged: plug it in again")
        nearest = replace(nearest, report_id=mine.report_id)
        node = _Node(self.system, nearest)
        if node.descriptor != descriptor:
            node.close()
            raise DigitizerError(f"{nearest.path} is another device than {mine.path} was: start the run again")
        self.device = nearest
        return node


def open_hidraw(system: HidSystem, name: str, *, reconnect: bool = True) -> HidrawSource:
    """Open the digitizer, or touch surface, of a name as `select_digitizer` takes it. Raises `DigitizerError`."""
    return HidrawSource(system, select_digitizer(name, find_digitizers(system)), reconnect=reconnect)


def read_descriptor(system: HidSystem, device: HidDigitizer) -> bytes:
    """The report descriptor, where the kernel says it without opening the device. Raises `DigitizerError`."""
    try:
        return _read_sysfs_descriptor(system.sysfs, device.path)
    except OSError:  # an older kernel, or a container without /sys: the device itself says it
        node = _Node(system, device)
        node.close()
        return node.descriptor


def _read_sysfs_descriptor(sysfs: Path, path: str) -> bytes:
    return (sysfs / Path(path).name / "device" / "report_descriptor").read_bytes()


class _Node:
    """Linux's own /dev/hidrawN, read only: hidapi opens read-write and offers nothing to wait on."""

    def __init__(self, system: HidSystem, device: HidDigitizer) -> None:
        try:
            self._descriptor = os.open(device.path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError as error:
            raise refusal(device, error) from error
        try:
            self.descriptor = _read_node_descriptor(self._descriptor, device.path, system.sysfs)
        except OSError as error:
            self.close()
            raise refusal(device, error) from error

    def fileno(self) -> int:
        return self._descriptor

    def read(self) -> bytes | None:
        """The next report, None where the device has sent no further one; OSError when the device is gone."""
        try:
            report = os.read(self._descriptor, _READ_BYTES)
        except BlockingIOError:
            return None
        if not report:
            raise OSError(errno.ENODEV, "the device hung up")
        return report

    def close(self) -> None:
        os.close(self._descriptor)


def _read_node_descriptor(descriptor: int, path: str, sysfs: Path) -> bytes:
    try:
        size = struct.unpack("<i", fcntl.ioctl(descriptor, _HIDIOCGRDESCSIZE, bytes(4)))[0]
        buffer = bytearray(struct.pack("<I", size) + bytes(4096))
        fcntl.ioctl(descriptor, _HIDIOCGRDESC, buffer)
    except OSError:
        return _read_sysfs_descriptor(sysfs, path)
    return bytes(buffer[4 : 4 + size])
