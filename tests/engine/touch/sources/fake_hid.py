"""A machine with HID devices that come and go: hidapi's module, and Linux's nodes as packet-mode pipes."""

from __future__ import annotations

import fcntl
import os
import shutil
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from engine.touch.sources.hid_discovery import HidSystem
from engine.touch.sources.hidraw import HidrawSource, open_hidraw
from tests.engine.touch.descriptors import BLOB, CONTACT_COUNT, COUNT_MAXIMUM_5, application, finger

MODE = bytes.fromhex("050d 090e a101 8507 0952 1500 250a 7508 9501 b102 c0")
DESCRIPTOR = application(finger(), finger(), CONTACT_COUNT, COUNT_MAXIMUM_5, BLOB) + MODE
RING = 63


def touch_report(*contacts: tuple[int, int, bool]) -> bytes:
    """Report 1 of `DESCRIPTOR`: up to two contacts of (id, x, tip)."""
    slots = (bytes([tip, name]) + x.to_bytes(2, "little") + b"\x64\0" for name, x, tip in contacts)
    return b"\x01" + b"".join(slots).ljust(12, b"\0") + bytes([len(contacts)])


@dataclass
class FakeDevice:
    """One HID interface; its reports wait in `queue` for hidapi's own handle, or in the node's pipe."""

    path: str
    vendor_id: int = 0x04F3
    product_id: int = 0x200A
    serial_number: str = ""
    port: str = "usb-0000:00:14.0-6/input0"
    product_string: str = "Touch Bar"
    usages: tuple[tuple[int, int], ...] = ((0x0D, 0x04), (0x0D, 0x0E), (0x01, 0x02))
    descriptor: bytes = DESCRIPTOR
    bus_type: int = 1
    hid_id: str = ""
    open_error: str = ""
    queue: deque[bytes] = field(default_factory=deque)
    features: dict[int, bytes] = field(default_factory=dict)
    asked_features: list[int] = field(default_factory=list)
    sent_features: list[bytes] = field(default_factory=list)
    writer: int | None = None


class FakeHandle:
    """`device` of hidapi, with its habits: the reason of a failed open stands in error() only."""

    def __init__(self, machine: FakeMachine) -> None:
        self.machine = machine
        self.opened: FakeDevice | None = None
        self.reason = ""
        self.blocks = True

    def open_path(self, path: bytes) -> None:
        device = self.machine.plugged.get(os.fsdecode(path))
        self.reason = "no such device" if device is None else device.open_error
        if device is None or self.reason:
            raise OSError("open failed")
        self.opened = device

    def close(self) -> None:
        self.opened = None

    def error(self) -> str:
        return self.reason

    def set_nonblocking(self, value: int) -> int:
        self.blocks = not value
        return 0

    def read(self, max_length: int) -> list[int]:
        assert self.opened is not None and not self.blocks, "would wait for ever"
        if self.opened.path not in self.machine.plugged:
            raise OSError("read error")
        return list(self.opened.queue.popleft()[:max_length]) if self.opened.queue else []

    def get_report_descriptor(self) -> list[int]:
        assert self.opened is not None
        return list(self.opened.descriptor)

    def get_feature_report(self, report_num: int, max_length: int) -> list[int]:
        assert self.opened is not None
        self.opened.asked_features.append(report_num)
        if report_num not in self.opened.features:
            raise OSError("read error")
        return list(self.opened.features[report_num][:max_length])

    def send_feature_report(self, buff: bytes) -> int:
        assert self.opened is not None
        self.opened.sent_features.append(bytes(buff))
        return len(buff)


@dataclass
class FakeMachine:
    """hidapi's module and the kernel's files in `folder`."""

    folder: Path
    plugged: dict[str, FakeDevice] = field(default_factory=dict)
    opened: list[HidrawSource] = field(default_factory=list)

    def system(self, backend: str = "hidraw") -> HidSystem:
        return HidSystem(self, backend, self.folder / "sys")

    def open(self, name: str, backend: str = "hidraw", *, reconnect: bool = True) -> HidrawSource:
        """A source of one of the devices, which is closed with the machine."""
        self.opened.append(open_hidraw(self.system(backend), name, reconnect=reconnect))
        return self.opened[-1]

    def enumerate(self) -> list[dict[str, Any]]:
        keys = ("vendor_id", "product_id", "serial_number", "product_string", "bus_type")
        found: list[dict[str, Any]] = []
        for device in self.plugged.values():
            own = {key: getattr(device, key) for key in keys} | {"path": os.fsencode(device.path)}
            own |= {"manufacturer_string": "", "interface_number": 0}
            found += [{**own, "usage_page": page, "usage": usage} for page, usage in device.usages]
        return found

    def device(self) -> FakeHandle:
        return FakeHandle(self)

    def plug(self, name: str = "hidraw0", **traits: Any) -> FakeDevice:
        """A device with a node of this name: a pipe that keeps packets apart, as hidraw keeps reports."""
        device = FakeDevice(str(self.folder / name), **traits)
        os.mkfifo(device.path)
        device.writer = os.open(device.path, os.O_RDWR | os.O_NONBLOCK)
        fcntl.fcntl(device.writer, fcntl.F_SETPIPE_SZ, 1 << 20)
        fcntl.fcntl(device.writer, fcntl.F_SETFL, os.O_NONBLOCK | os.O_DIRECT)
        about = self.folder / "sys" / name / "device"
        about.mkdir(parents=True)
        (about / "report_descriptor").write_bytes(device.descriptor)
        (about / "uevent").write_text(f"DRIVER=hid-multitouch\nHID_ID={device.hid_id}\nHID_PHYS={device.port}\n")
        self.plugged[device.path] = device
        return device

    def unplug(self, device: FakeDevice) -> None:
        assert device.writer is not None
        os.close(device.writer)
        Path(device.path).unlink()
        shutil.rmtree(self.folder / "sys" / Path(device.path).name)
        del self.plugged[device.path]

    def send(self, device: FakeDevice, *reports: bytes) -> None:
        assert device.writer is not None
        for report in reports:
            os.write(device.writer, report)

    def close(self) -> None:
        for source in self.opened:
            source.close()
        for device in tuple(self.plugged.values()):
            self.unplug(device)
