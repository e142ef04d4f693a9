"""Finds the digitizers among the HID interfaces of this machine, chooses one by name, and explains missing rights."""

import importlib
import os
import re
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol, cast

from base.errors import TactableError
from engine.touch.descriptor import SurfaceKind
from engine.touch.digitizer import DigitizerError
from engine.touch.sources.evdev import SLOT_AXES

RULE_FILE = "/etc/udev/rules.d/70-tactable.rules"  # before 73-seat-late.rules, which acts on the tag

_DIGITIZER_PAGE = 0x0D  # HID Usage Tables
_TOUCH_USAGES = frozenset(kind.value for kind in SurfaceKind)
_VENDOR_AND_PRODUCT = re.compile(r"([0-9a-fA-F]{4}):([0-9a-fA-F]{4})")
# hidapi's number of a bus to the kernel's, which recordings hold: USB, Bluetooth, I2C, SPI.
_KERNEL_BUS = {1: 0x03, 2: 0x05, 3: 0x18, 4: 0x1C}


class HidModule(Protocol):
    """The part of a hidapi module that is used."""

    def enumerate(self) -> list[dict[str, Any]]:
        """One entry per top-level collection."""


@dataclass(frozen=True)
class HidSystem:
    """Module of hidapi that lists devices, and the folder in which the kernel describes their nodes /dev/hidrawN."""

    module: HidModule
    sysfs: Path = Path("/sys/class/hidraw")


def load_hid_system(import_module: Callable[[str], object] = importlib.import_module) -> HidSystem:
    """Import the module `hidraw` of hidapi. Raises `DigitizerError` where it is not installed.

    Its other module, `hid`, uses libusb, which detaches the touch screen from the desktop and sees no I2C or Bluetooth.
    """
    try:
        return HidSystem(cast(HidModule, import_module("hidraw")))
    except ImportError:
        raise DigitizerError("hidapi with its module hidraw is not installed: run `pip install -U hidapi`") from None


@dataclass(frozen=True)
class HidDigitizer:
    """One HID interface with a touch collection; empty where the device or the system does not say.

    `bus` is the kernel's number; `port` is where it is plugged in, the same after a replug. `report_id` is that of the
    touch surface that was chosen; None: the one that reports is meant.
    """

    path: str
    name: str
    vendor_id: int
    product_id: int
    serial_number: str = ""
    bus: int = 0
    interface_number: int = -1
    port: str = ""
    report_id: int | None = None

    @property
    def number(self) -> str:
        """Vendor and product as 04f3:200a."""
        return f"{self.vendor_id:04x}:{self.product_id:04x}"

    @property
    def stable_id(self) -> str:
        """The serial number; else vendor, product and port; else the path."""
        return self.serial_number or (f"{self.number}@{self.port}" if self.port else self.path)


def find_digitizers(system: HidSystem) -> tuple[HidDigitizer, ...]:
    """Every interface with a touch screen or touch pad collection, in the order of its path; opens none.

    Raises `DigitizerError` when the system cannot say.
    """
    try:
        collections = system.module.enumerate()
    except OSError as error:
        raise DigitizerError(f"cannot list HID devices: {error}") from error
    touch = [c for c in collections if c["usage_page"] == _DIGITIZER_PAGE and c["usage"] in _TOUCH_USAGES]
    by_path = {os.fsdecode(collection["path"]): collection for collection in touch}
    return tuple(_digitizer(system, path, by_path[path]) for path in sorted(by_path))


def _digitizer(system: HidSystem, path: str, collection: dict[str, Any]) -> HidDigitizer:
    manufacturer, product = (collection.get(f"{key}_string") or "" for key in ("manufacturer", "product"))
    kernel = _read_uevent(system.sysfs, path)
    return HidDigitizer(
        path=path,
        name=product if product.startswith(manufacturer) else f"{manufacturer} {product}".strip(),
        vendor_id=collection["vendor_id"],
        product_id=collection["product_id"],
        serial_number=(collection.get("serial_number") or "").strip(),
        bus=_kernel_bus(kernel) or _KERNEL_BUS.get(collection.get("bus_type", 0), 0),
        interface_number=collection.get("interface_number", -1),
        port=kernel.get("HID_PHYS", ""),
    )


def _read_uevent(sysfs: Path, path: str) -> dict[str, str]:
    """The kernel's properties of a node, such as HID_PHYS=usb-0000:00:14.0-6/input0; empty where it has none."""
    try:
        text = (sysfs / Path(path).name / "device" / "uevent").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return {}
    return {key: value for key, _, value in (line.partition("=") for line in text.splitlines())}


def _kernel_bus(kernel: dict[str, str]) -> int:
    """Bus of HID_ID=0003:000004F3:0000200A, 0 where it is absent: hidapi does not know every bus."""
    digits = kernel.get("HID_ID", "").partition(":")[0]
    return int(digits, 16) if re.fullmatch("[0-9A-Fa-f]+", digits) else 0


def select_digitizer(name: str, found: Sequence[HidDigitizer]) -> HidDigitizer:
    """The one digitizer called `name`: its path, stable id, serial number or vendor:product.

    With `#` and a report ID in hex behind it, such as 17ef:6161#38, the touch surface with that report is chosen.
    Raises `DigitizerError` when none or several are called so.
    """
    named, report_id = name, None
    if not any(name in (d.path, d.stable_id, d.serial_number) for d in found):
        named, report_id = split_surface(name)
    matches = [d for d in found if named in (d.path, d.stable_id, d.serial_number)]
    matches = matches or [d for d in found if d.number == named.lower()]
    if len(matches) == 1:
        return replace(matches[0], report_id=report_id)
    if matches:
        raise DigitizerError(f"{name!r} is {len(matches)} digitizers; choose one: {', '.join(d.path for d in matches)}")
    known = ", ".join(f"{d.stable_id} ({d.path})" for d in found) or "none"
    raise DigitizerError(f"no digitizer {name!r}: plug it in, or choose one that `tactable list` shows; found: {known}")


def split_surface(name: str) -> tuple[str, int | None]:
    """Split a name such as 17ef:6161#38 into the digitizer or recording and the report ID; None without a report ID.

    Raises `DigitizerError` where what follows the `#` is no report ID.
    """
    named, mark, digits = name.rpartition("#")
    if not mark:
        return name, None
    if not re.fullmatch("[0-9A-Fa-f]{1,2}", digits):
        raise DigitizerError(f"{name!r}: {digits!r} is no report ID; write two hex digits, as `tactable list` does")
    return named, int(digits, 16)


def parse_number(text: str) -> tuple[int, int] | None:
    """Vendor and product of a text like 04f3:200a, None for another text."""
    found = _VENDOR_AND_PRODUCT.fullmatch(text)
    return None if found is None else (int(found[1], 16), int(found[2], 16))


def udev_rule(vendor_id: int, product_id: int) -> str:
    """The udev rule that lets the logged-in user read the device. The kernel's names have capital digits."""
    return f'SUBSYSTEM=="hidraw", KERNELS=="*:{vendor_id:04X}:{product_id:04X}.*", TAG+="uaccess"'


def refusal(device: HidDigitizer, reason: object) -> DigitizerError:
    """Why a device cannot be opened or read, and what to do about it."""
    what = f"{device.path} ({device.name or device.number})"
    if isinstance(reason, PermissionError):
        return DigitizerError(
            f"no permission to read {what}: put this udev rule into {RULE_FILE} "
            f"(`tactable doctor --emit-udev` prints it), then plug the device in again: "
            f"{udev_rule(device.vendor_id, device.product_id)}"
        )
    return DigitizerError(f"cannot read {what}: {reason}; plug it in again, and end other programs that use it")


def find_event_node(system: HidSystem, device: HidDigitizer) -> str | None:
    """Path of the device's input node with multitouch slots, which a kernel driver fills; None without one."""
    inputs = system.sysfs / Path(device.path).name / "device" / "input"
    for node in sorted(inputs.glob("input*/event*")):
        try:
            words = (node.parent / "capabilities" / "abs").read_text(encoding="ascii").split()
        except OSError:
            continue  # unplugged meanwhile
        # The kernel writes a bit for each axis as words of an unsigned long in hex, the highest word first.
        bits = sum(int(word, 16) << 8 * struct.calcsize("l") * place for place, word in enumerate(reversed(words)))
        if all(bits >> axis & 1 for axis in SLOT_AXES):
            return f"/dev/input/{node.name}"
    return None


def undecodable(system: HidSystem, device: HidDigitizer, error: TactableError) -> DigitizerError:
    """Why the reports of a device cannot be decoded, with the node from which its touches can be read all the same."""
    node = find_event_node(system, device)
    return DigitizerError(f"{error}; {device.path} is {node} there: choose that" if node else str(error))
