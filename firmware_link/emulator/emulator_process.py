"""Emulated firmware as a child process behind a pseudo-terminal, and the handle of its parent."""

import contextlib
import signal
import socket
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from base.child import START_TIMEOUT_S, Child, Parent
from base.files import work_folder
from firmware_link.emulator.device_server import DeviceServer
from firmware_link.emulator.device_state import DeviceConfiguration
from firmware_link.emulator.drive_log import DriveEvent, Outcome, ReceivedFrame, decode_drive_event
from firmware_link.emulator.fault_plan import FaultPlan
from firmware_link.emulator.faulty_device import FaultyDevice
from firmware_link.emulator.firmware import EmulatedFirmware
from firmware_link.emulator.pty import PseudoTerminal, serve
from firmware_link.host.emulator_registry import Announcement

MODULE = "firmware_link.emulator.emulator_process"
_STOP_TIMEOUT_S = 10.0  # to say its log; a child that takes longer hangs
UNPLUGGED_US = 300_000  # past the watchdog of 250 ms: the device latches, and the host looks for its port


@dataclass(frozen=True)
class EmulatorLog:
    """Actions of a device in one boot; times are microseconds since that boot.

    `counters` are its own; `faults` those of the line since the emulator started; `earlier` are the boots before.
    """

    number_of_actuators: int
    host_ns_at_device_zero: int
    events: tuple[DriveEvent, ...]
    received: tuple[ReceivedFrame, ...]
    counters: dict[str, int]
    earlier: "tuple[EmulatorLog, ...]" = ()
    faults: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Applied:
    """The drive events since the last question; every event is before `until_us`."""

    until_us: float
    host_ns_at_device_zero: int
    events: tuple[DriveEvent, ...]


class RunningEmulator:
    """A started emulator: `port` opens like any serial port; its device time 0 is `host_ns_at_device_zero`.

    `stable_port` is a link that leads to its port also after the port has come back under another name.
    """

    def __init__(self, child: Child, stable_port: Path) -> None:
        greeting = child.read(START_TIMEOUT_S)
        self.port: str = greeting["port"]
        self.stable_port = str(stable_port)
        self.host_ns_at_device_zero: int = greeting["host_ns_at_device_zero"]
        self.process_id = child.process_id
        self._child = child

    def log(self) -> EmulatorLog:
        """Ask for what it has done so far."""
        return decode_log(self._ask("log"))

    def reboot(self) -> None:
        """Power the device off and on."""
        self._ask("reboot")

    def unplug(self) -> None:
        """Pull the cable for UNPLUGGED_US."""
        self._ask("unplug")

    def stop(self) -> EmulatorLog:
        """End the process; what it did. Raises ChildError when it died before."""
        self._child.ask_to_end()
        log = decode_log(self._child.read(_STOP_TIMEOUT_S))
        self._child.end()
        return log

    def _ask(self, word: str) -> dict[str, Any]:
        return self._child.ask({"do": word}, START_TIMEOUT_S)


@contextlib.contextmanager
def run_emulator(configuration: DeviceConfiguration | None = None) -> Iterator[RunningEmulator]:
    """Run an emulator process for the length of a `with` block; it ends with the block in every case."""
    with work_folder("emulator") as folder:
        link = folder / "port"
        arguments = {"configuration": configuration or DeviceConfiguration(0), "link": str(link)}
        with Child(MODULE, arguments, name="the emulator") as child:
            yield RunningEmulator(child, link)


def decode_applied(document: dict[str, Any]) -> Applied:
    """The answer to `{"do": "take"}`."""
    return Applied(**document | {"events": tuple(decode_drive_event(item) for item in document["events"])})


def decode_log(document: dict[str, Any]) -> EmulatorLog:
    """The log of `DeviceServer.log`."""
    *earlier, last = (_decode_boot(document["number_of_actuators"], boot) for boot in document["boots"])
    return replace(last, earlier=tuple(earlier), faults=document["faults"])


def _decode_boot(number_of_actuators: int, boot: dict[str, Any]) -> EmulatorLog:
    return EmulatorLog(
        number_of_actuators=number_of_actuators,
        host_ns_at_device_zero=boot["host_ns_at_device_zero"],
        events=tuple(decode_drive_event(item) for item in boot["events"]),
        received=tuple(ReceivedFrame(**item | {"outcome": Outcome(item["outcome"])}) for item in boot["received"]),
        counters=boot["counters"],
    )


def main(parent: Parent, arguments: dict[str, Any]) -> None:
    """Say the port, serve until a signal or until the parent asks for the end, then say the log.

    The parent's lines `{"do": "log" | "take" | "reboot" | "unplug"}` are each answered by a line. With "take" the
    device forgets what was answered, as one that runs for hours must.
    """
    configuration: DeviceConfiguration = arguments["configuration"]
    device = FaultyDevice(lambda boot: EmulatedFirmware(replace(configuration, boot_id=boot)), FaultPlan(), seed=0)
    link = Announcement(Path(arguments["link"])) if arguments["link"] else None
    follow = () if link is None else (link.point_to, link.close)
    server = DeviceServer(device, PseudoTerminal, time.monotonic_ns(), *follow)
    with termination_descriptor() as termination:
        assert server.terminal is not None
        parent.say({"port": server.terminal.name, "host_ns_at_device_zero": server.host_ns_at_zero})
        while serve(server, [termination, parent.fileno()]) != termination and (order := parent.read()):
            now_ns, said = time.monotonic_ns(), dict[str, Any]()
            match order["do"]:
                case "log":
                    said = server.log()
                case "take":
                    said = server.take_events(now_ns)
                case "reboot":
                    server.reboot(now_ns)
                case "unplug":
                    server.unplug(now_ns, UNPLUGGED_US)
            parent.say(said)
    server.close()
    parent.say(server.log())


@contextlib.contextmanager
def termination_descriptor() -> Iterator[int]:
    """Yield a descriptor that becomes readable when SIGTERM or SIGINT comes."""
    reader, writer = socket.socketpair()
    with reader, writer:
        writer.setblocking(False)
        signal.set_wakeup_fd(writer.fileno())
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: None)
        yield reader.fileno()
        signal.set_wakeup_fd(-1)
