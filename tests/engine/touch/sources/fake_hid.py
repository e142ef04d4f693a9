"""Sources made up: a machine with HID devices that come and go, and both ends of a pipe of pointer events."""

from __future__ import annotations

import fcntl
import os
import shutil
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from engine.touch.sources.hid_discovery import HidSystem
from engine.touch.sources.hidraw import HidrawSource, open_hidraw
from engine.touch.sources.pointer import PointerFeed, PointerSource
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
    """One HID interface; its reports wait in the node's pipe."""

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
    writer: int | None = None


@dataclass
class FakeMachine:
    """hidapi's module and the kernel's files in `folder`."""

    folder: Path
    plugged: dict[str, FakeDevice] = field(default_factory=dict)
    opened: list[HidrawSource] = field(default_factory=list)

    def system(self) -> HidSystem:
        return HidSystem(self, self.folder / "sys")

    def open(self, name: str, *, reconnect: bool = True) -> HidrawSource:
        self.opened.append(open_hidraw(self.system(), name, reconnect=reconnect))
        return self.opened[-1]

    def enumerate(self) -> list[dict[str, Any]]:
        keys = ("vendor_id", "product_id", "serial_number", "product_string", "bus_type")
        found: list[dict[str, Any]] = []
        for device in self.plugged.values():
            own = {key: getattr(device, key) for key in keys} | {"path": os.fsencode(device.path)}
            own |= {"manufacturer_string": "", "interface_number": 0}
            found += [{**own, "usage_page": page, "usage": usage} for page, usage in device.usages]
        return found

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


def open_pointer_pipe() -> tuple[PointerSource, PointerFeed]:
    """The reading and the writing end of a new pipe."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    return PointerSource(reading), PointerFeed(writing)
