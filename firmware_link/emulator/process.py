"""Emulated firmware as a child process behind a pseudo-terminal, and the handle of its parent."""

import argparse
import contextlib
import json
import secrets
import select
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from firmware_link.emulator.drive_log import (
    DriveEvent,
    ReceivedFrame,
    decode_drive_event,
    decode_received_frame,
)
from firmware_link.emulator.fault_plan import FaultPlanError, parse_fault_plan
from firmware_link.emulator.faulty_device import FaultyDevice
from firmware_link.emulator.firmware import EmulatedFirmware
from firmware_link.emulator.pty import PseudoTerminalServer
from firmware_link.emulator.state import LONGEST_LEASE_MS, DeviceConfiguration
from firmware_link.host.emulator_registry import Announcement
from firmware_link.protocol.bank import Bank, decode_bank, hash_of_bank
from firmware_link.protocol.errors import LinkError

# Generous: the interpreter starts within 0.1 s on an idle machine, within seconds on a crowded one.
START_TIMEOUT_S = 30.0
STOP_TIMEOUT_S = 10.0
_LOG_WORD = "log"
_REBOOT_WORD = "reboot"
_UNPLUG_WORD = "unplug"
UNPLUGGED_US = 300_000


@dataclass(frozen=True)
class EmulatorLog:
    """What a device did in one boot; times are microseconds since that boot.

    `counters` are its own; `faults` those of the line since the emulator started; `earlier` are the boots before.
    """

    number_of_actuators: int
    host_ns_at_device_zero: int
    events: tuple[DriveEvent, ...]
    received: tuple[ReceivedFrame, ...]
    counters: dict[str, int]
    banks: dict[int, Bank] = field(default_factory=dict)
    earlier: "tuple[EmulatorLog, ...]" = ()
    faults: dict[str, int] = field(default_factory=dict)


class RunningEmulator:
    """A started emulator: `port` opens like any serial port; its device time 0 is `host_ns_at_device_zero`.

    `stable_port` is a link that leads to its port also after the port has come back under another name.
    """

    def __init__(self, process: "subprocess.Popen[str]", stable_port: Path, log_path: Path) -> None:
        greeting = _read_answer(process)
        self.port: str = greeting["port"]
        self.stable_port = str(stable_port)
        self.host_ns_at_device_zero: int = greeting["host_ns_at_device_zero"]
        self.process_id = process.pid
        self._process = process
        self._log_path = log_path

    def log(self) -> EmulatorLog:
        """Ask for what it has done so far."""
        return _decode_log(self._ask(_LOG_WORD))

    def reboot(self) -> None:
        """Power the device off and on."""
        self._ask(_REBOOT_WORD)

    def unplug(self) -> None:
        """Pull the cable for UNPLUGGED_US."""
        self._ask(_UNPLUG_WORD)

    def stop(self) -> EmulatorLog:
        """End the process and read what it did; raises LinkError when it left no log."""
        _end_process(self._process)
        return read_log(self._log_path)

    def _ask(self, word: str) -> dict[str, Any]:
        assert self._process.stdin is not None
        self._process.stdin.write(f"{word}\n")
        self._process.stdin.flush()
        return _read_answer(self._process)


@contextlib.contextmanager
def run_emulator(
    number_of_actuators: int = 2, longest_lease_ms: int = LONGEST_LEASE_MS, faults: str = "", seed: int = 0
) -> Iterator[RunningEmulator]:
    """Run an emulator process for the length of a `with` block; it ends with the block in every case.

    `faults` is a text for `parse_fault_plan`; raises FaultPlanError for another.
    """
    parse_fault_plan(faults)
    with tempfile.TemporaryDirectory(prefix="tactable-emulator-") as folder:
        log_path, link = Path(folder) / "log.json", Path(folder) / "port"
        arguments = {
            "--actuators": number_of_actuators,
            "--lease-ms": longest_lease_ms,
            "--faults": faults,
            "--seed": seed,
            "--log": log_path,
            "--link": link,
        }
        process = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "firmware_link.emulator.process",
                *(f"{key}={value}" for key, value in arguments.items()),
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            yield RunningEmulator(process, link, log_path)
        finally:
            _end_process(process)


def read_log(path: Path) -> EmulatorLog:
    """Read the log that an emulator wrote; raises LinkError when there is none."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise LinkError(f"the emulator left no log at {path}: {error}") from error
    return _decode_log(document)


def _decode_log(document: dict[str, Any]) -> EmulatorLog:
    *earlier, last = (_decode_boot(document["number_of_actuators"], boot) for boot in document["boots"])
    return replace(last, earlier=tuple(earlier), faults=document["faults"])


def _decode_boot(number_of_actuators: int, boot: dict[str, Any]) -> EmulatorLog:
    return EmulatorLog(
        number_of_actuators=number_of_actuators,
        host_ns_at_device_zero=boot["host_ns_at_device_zero"],
        events=tuple(decode_drive_event(item) for item in boot["events"]),
        received=tuple(decode_received_frame(item) for item in boot["received"]),
        counters=boot["counters"],
        banks={
            hash_of_bank(data): decode_bank(data, number_of_actuators) for data in map(bytes.fromhex, boot["banks"])
        },
    )


def _read_answer(process: "subprocess.Popen[str]") -> dict[str, Any]:
    assert process.stdout is not None
    ready, _, _ = select.select([process.stdout], [], [], START_TIMEOUT_S)
    line = process.stdout.readline() if ready else ""
    if not line:
        raise LinkError(f"the emulator did not start or does not run: exit status {process.poll()}, see above")
    answer: dict[str, Any] = json.loads(line)
    return answer


def _end_process(process: "subprocess.Popen[str]") -> None:
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.close()
    try:
        process.wait(STOP_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    process.stdout.close()


def main() -> None:
    """Print one JSON line with the port, serve until SIGTERM or the end of standard input, write the log.

    The words `log`, `reboot` and `unplug` on standard input, a line each, are answered by a line of JSON.
    """
    configuration, arguments = _parse_arguments()
    announcement = Announcement(arguments.link) if arguments.link else None
    server = PseudoTerminalServer(
        FaultyDevice(lambda boot_id: EmulatedFirmware(replace(configuration, boot_id=boot_id)), *arguments.plan),
        announcement.point_to if announcement else lambda _: None,
    )
    with termination_descriptor() as termination:
        _answer({"port": server.path, "simulated": True, "host_ns_at_device_zero": server.host_ns_at_zero})
        while server.serve([termination, sys.stdin.fileno()]) != termination:
            word = sys.stdin.readline().strip()
            if word == _REBOOT_WORD:
                server.reboot()
                _answer({})
            elif word == _UNPLUG_WORD:
                server.unplug(UNPLUGGED_US)
                _answer({})
            elif word == _LOG_WORD:
                _answer(server.log())
            else:
                break
    server.close()
    if announcement:
        announcement.close()
    if arguments.log is not None:
        arguments.log.write_text(json.dumps(server.log()), encoding="utf-8")


def _answer(document: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(document) + "\n")
    sys.stdout.flush()


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


def _parse_arguments() -> tuple[DeviceConfiguration, argparse.Namespace]:
    parser = argparse.ArgumentParser(prog="firmware_link.emulator.process", description=__doc__)
    parser.add_argument("--actuators", type=int, default=2, help="number of actuators, 1 to 255")
    parser.add_argument("--lease-ms", type=int, default=LONGEST_LEASE_MS, help="longest lease that it grants, in ms")
    parser.add_argument("--faults", default="", help="faults to inject, such as bit_errors=1e-5,reboot@12s")
    parser.add_argument("--seed", type=int, default=secrets.randbits(32), help="makes the faults the same again")
    parser.add_argument("--log", type=Path, help="where to write what it did, as JSON, when it ends")
    parser.add_argument("--link", type=Path, help="a symbolic link that leads to its port")
    arguments = parser.parse_args()
    try:
        arguments.plan = (parse_fault_plan(arguments.faults), arguments.seed)
        return DeviceConfiguration(0, arguments.actuators, arguments.lease_ms), arguments
    except (ValueError, FaultPlanError) as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
