"""A USB serial port without hardware: a gadget on dummy_hcd, and the emulated firmware on its device side."""

import contextlib
import os
import select
import time
import tty
from dataclasses import asdict
from multiprocessing.connection import Connection
from pathlib import Path

from firmware_link.emulator.device_state import DeviceConfiguration
from firmware_link.emulator.emulator_process import EmulatorLog
from firmware_link.emulator.firmware import EmulatedFirmware
from firmware_link.host.serial_port import READ_SIZE

SERIAL_NUMBER = "TACTABLE-SYSTEM-TEST"
_GADGET = Path("/sys/kernel/config/usb_gadget/tactable")
_CONTROLLER = "dummy_udc.0"
_DEVICE_SIDE = "/dev/ttyGS0"
_US_PER_S = 1e6
_NS_PER_US = 1_000


def build_gadget() -> None:
    """Describe the gadget to the kernel: one CDC ACM function; not plugged in yet."""
    identity = {"idVendor": "0xfffe", "idProduct": "0x7ab2"}
    strings = {"serialnumber": SERIAL_NUMBER, "product": "tactable system test", "manufacturer": "SIMULATED"}
    for folder in ("strings/0x409", "configs/c.1", "functions/acm.0"):
        (_GADGET / folder).mkdir(parents=True)
    for name, value in identity.items():
        (_GADGET / name).write_text(value)
    for name, value in strings.items():
        (_GADGET / "strings/0x409" / name).write_text(value)
    (_GADGET / "configs/c.1/acm.0").symlink_to(_GADGET / "functions/acm.0")


def plug_gadget() -> None:
    """Connect the gadget: the host's driver makes a /dev/ttyACM of it a little later."""
    (_GADGET / "UDC").write_text(_CONTROLLER)


def unplug_gadget() -> None:
    """Pull the cable; the firmware keeps its power."""
    (_GADGET / "UDC").write_text("\n")


def serve_firmware(configuration: DeviceConfiguration, owner: Connection) -> None:
    """Be the firmware until the owner says something; answer that with the EmulatorLog."""
    firmware = EmulatedFirmware(configuration)
    zero_ns = time.monotonic_ns()
    port = _open_device_side()
    while True:
        now_us = (time.monotonic_ns() - zero_ns) // _NS_PER_US
        deadline_us = firmware.next_deadline_us()
        timeout_s = None if deadline_us is None else max(0.0, (deadline_us - now_us) / _US_PER_S)
        ready, _, _ = select.select([port, owner.fileno()], [], [], timeout_s)
        if owner.fileno() in ready:
            break
        data = b""
        if port in ready:
            data = _read(port)
            if not data:
                os.close(port)
                port = _open_device_side()
        _write(port, firmware.receive(data, (time.monotonic_ns() - zero_ns) // _NS_PER_US))
    os.close(port)
    counters = asdict(firmware.counters) | asdict(firmware.framing_counters)
    drives, received = tuple(firmware.drive_log), tuple(firmware.received)
    owner.send(EmulatorLog(configuration.number_of_actuators, zero_ns, drives, received, counters))


def _open_device_side() -> int:
    port = os.open(_DEVICE_SIDE, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    tty.setraw(port)
    return port


def _read(port: int) -> bytes:
    """What has come; nothing after an unplug, which hangs the terminal up."""
    try:
        return os.read(port, READ_SIZE)
    except OSError:
        return b""


def _write(port: int, data: bytes) -> None:
    """A host that does not read loses what the device says, as on a wire; of a hang-up the next read tells."""
    if data:
        with contextlib.suppress(OSError):
            os.write(port, data)
