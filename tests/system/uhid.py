"""A recording's device as a real one: the kernel binds its driver, and reports come out of /dev/hidrawN."""

import contextlib
import os
import select
import struct
import threading
from enum import IntEnum
from pathlib import Path
from types import TracebackType
from typing import Self

from engine.touch.sources.recording import Recording

# include/uapi/linux/uhid.h: u32 type, then the event; all packed.
_EVENT_SIZE = 4380
_CREATE = struct.Struct("<I128s64s64sHHIIII4096s")
_INPUT = struct.Struct("<IH")
_GET_REPORT = struct.Struct("<IIBB")
_GET_REPORT_REPLY = struct.Struct("<IIHH4096s")
_SET_REPORT = struct.Struct("<IIBBH")
_SET_REPORT_REPLY = struct.Struct("<IIH")
_EIO = 5
_POLL_MS = 50


class _Type(IntEnum):
    DESTROY = 1
    OPEN = 4
    CLOSE = 5
    GET_REPORT = 9
    GET_REPORT_REPLY = 10
    CREATE2 = 11
    INPUT2 = 12
    SET_REPORT = 13
    SET_REPORT_REPLY = 14


class VirtualDevice:
    """Plugged in for the length of a `with` block; `features` are the feature reports it has, by report ID.

    A thread answers the kernel's questions: left unanswered, each holds the driver's probe up for 5 s.
    """

    def __init__(self, device: Recording, serial_number: str, features: dict[int, bytes]) -> None:
        self.opened = threading.Event()
        """Set while somebody has the device open."""
        self._serial_number = serial_number
        self._device = device
        self._features = features
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._answer_questions, daemon=True)

    def __enter__(self) -> Self:
        device = self._device
        self._descriptor = os.open("/dev/uhid", os.O_RDWR | os.O_CLOEXEC)
        names = (device.name.encode()[:127], b"", self._serial_number.encode())
        identity = (device.bus, device.vendor_id, device.product_id, 0, 0)
        size = len(device.descriptor)
        os.write(self._descriptor, _CREATE.pack(_Type.CREATE2, *names, size, *identity, device.descriptor))
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.write(self._descriptor, struct.pack("<I", _Type.DESTROY))
        self._ended.set()
        self._thread.join()
        os.close(self._descriptor)

    def send(self, report: bytes) -> None:
        os.write(self._descriptor, _INPUT.pack(_Type.INPUT2, len(report)) + report)

    def _answer_questions(self) -> None:
        poll = select.poll()
        poll.register(self._descriptor, select.POLLIN)
        while not self._ended.is_set():
            if poll.poll(_POLL_MS):
                self._answer(os.read(self._descriptor, _EVENT_SIZE))

    def _answer(self, event: bytes) -> None:
        match int.from_bytes(event[:4], "little"):
            case _Type.OPEN:
                self.opened.set()
            case _Type.CLOSE:
                self.opened.clear()
            case _Type.GET_REPORT:
                _, request, report_id, _ = _GET_REPORT.unpack_from(event)
                data = self._features.get(report_id)
                reply = (_EIO, 0, b"") if data is None else (0, len(data), data)
                self._reply(_GET_REPORT_REPLY.pack(_Type.GET_REPORT_REPLY, request, *reply))
            case _Type.SET_REPORT:
                _, request, _, _, _ = _SET_REPORT.unpack_from(event)
                self._reply(_SET_REPORT_REPLY.pack(_Type.SET_REPORT_REPLY, request, 0))

    def _reply(self, event: bytes) -> None:
        # The kernel may have given up on the question, or the device been unplugged meanwhile.
        with contextlib.suppress(OSError):
            os.write(self._descriptor, event)


def kernel_path_of(vendor_id: int, product_id: int) -> Path:
    """Where the kernel shows the first HID device with these numbers; raises StopIteration without one."""
    return next(Path("/sys/bus/hid/devices").glob(f"*:{vendor_id:04X}:{product_id:04X}.*"))
