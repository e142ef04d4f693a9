"""The emulated firmware as a process of its own behind a pseudo-terminal, and the handle of who started it."""

import argparse
import contextlib
import json
import os
import secrets
import select
import signal
import socket
import subprocess
import sys
import tempfile
import time
import tty
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from firmware_link.device import LONGEST_LEASE_MS, DeviceConfiguration, EmulatedFirmware
from firmware_link.drive_log import (
    DriveEvent,
    ReceivedFrame,
    decode_drive_event,
    decode_received_frame,
    encode_events,
)
from firmware_link.errors import LinkError

NS_PER_US = 1_000
US_PER_MS = 1_000
READ_SIZE = 4096
# A host that does not read loses what the device says, as on a wire.
UNSENT_LIMIT = 8192
# Generous: the interpreter starts within 0.1 s on an idle machine, within seconds on a crowded one.
START_TIMEOUT_S = 30.0
STOP_TIMEOUT_S = 10.0


@dataclass(frozen=True)
class EmulatorLog:
    """What an emulator did, times in microseconds since its start (device time 0)."""

    number_of_actuators: int
    host_ns_at_device_zero: int
    events: tuple[DriveEvent, ...]
    received: tuple[ReceivedFrame, ...]
    counters: dict[str, int]


class RunningEmulator:
    """A started emulator: `port` opens like any serial port; its device time 0 is `host_ns_at_device_zero`."""

    def __init__(self, process: "subprocess.Popen[str]", log_path: Path) -> None:
        greeting = _read_greeting(process)
        self.port: str = greeting["port"]
        self.host_ns_at_device_zero: int = greeting["host_ns_at_device_zero"]
        self.process_id = process.pid
        self._process = process
        self._log_path = log_path

    def stop(self) -> EmulatorLog:
        """End the process and read what it did; raises LinkError when it left no log."""
        _end_process(self._process)
        return read_log(self._log_path)


@contextlib.contextmanager
def run_emulator(number_of_actuators: int = 2, longest_lease_ms: int = LONGEST_LEASE_MS) -> Iterator[RunningEmulator]:
    """An emulator process for the length of a `with` block; whatever happens in it, none is left behind."""
    with tempfile.TemporaryDirectory(prefix="tactable-emulator-") as folder:
        log_path = Path(folder) / "log.json"
        arguments = [
            "--actuators",
            str(number_of_actuators),
            "--lease-ms",
            str(longest_lease_ms),
            "--log",
            str(log_path),
        ]
        process = subprocess.Popen(
            [sys.executable, "-m", "firmware_link.emulator", *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            yield RunningEmulator(process, log_path)
        finally:
            _end_process(process)


def read_log(path: Path) -> EmulatorLog:
    """The log that an emulator wrote; raises LinkError when there is none."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise LinkError(f"the emulator left no log at {path}: {error}") from error
    return EmulatorLog(
        number_of_actuators=document["number_of_actuators"],
        host_ns_at_device_zero=document["host_ns_at_device_zero"],
        events=tuple(decode_drive_event(item) for item in document["events"]),
        received=tuple(decode_received_frame(item) for item in document["received"]),
        counters=document["counters"],
    )


def _read_greeting(process: "subprocess.Popen[str]") -> dict[str, Any]:
    assert process.stdout is not None
    ready, _, _ = select.select([process.stdout], [], [], START_TIMEOUT_S)
    line = process.stdout.readline() if ready else ""
    if not line:
        raise LinkError(f"the emulator did not start: exit status {process.poll()}, its messages are above")
    greeting: dict[str, Any] = json.loads(line)
    return greeting


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


class PseudoTerminalServer:
    """Serves one firmware on a new pseudo-terminal with one poll loop and the monotonic clock."""

    def __init__(self, firmware: EmulatedFirmware) -> None:
        self.firmware = firmware
        # The slave stays open here, so that hosts may come and go without the terminal hanging up.
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        self.host_ns_at_device_zero = time.monotonic_ns()
        self._unsent = b""

    def serve(self, end_descriptors: list[int]) -> None:
        """Serve until one of the descriptors has something to read, or has closed."""
        poll = select.poll()
        for descriptor in end_descriptors:
            poll.register(descriptor, select.POLLIN)
        while True:
            poll.register(self._master, select.POLLIN | (select.POLLOUT if self._unsent else 0))
            ready = {descriptor for descriptor, _ in poll.poll(self._timeout_ms())}
            if ready.intersection(end_descriptors):
                return
            self._send(self._receive() if self._master in ready else self.firmware.advance(self._now_us()))

    def close(self) -> None:
        """Let the terminal go."""
        os.close(self._master)
        os.close(self._slave)

    def log(self) -> dict[str, Any]:
        """What the firmware did, for JSON; `read_log` reads it back."""
        return {
            "simulated": True,
            "number_of_actuators": self.firmware.configuration.number_of_actuators,
            "host_ns_at_device_zero": self.host_ns_at_device_zero,
            "events": encode_events(self.firmware.drive_log),
            "received": encode_events(self.firmware.received),
            "counters": asdict(self.firmware.counters) | asdict(self.firmware.framing_counters),
        }

    def _now_us(self) -> int:
        return (time.monotonic_ns() - self.host_ns_at_device_zero) // NS_PER_US

    def _timeout_ms(self) -> int | None:
        deadline_us = self.firmware.next_deadline_us()
        return None if deadline_us is None else max(0, -((self._now_us() - deadline_us) // US_PER_MS))

    def _receive(self) -> bytes:
        try:
            data = os.read(self._master, READ_SIZE)
        except BlockingIOError:
            data = b""
        return self.firmware.receive(data, self._now_us())

    def _send(self, data: bytes) -> None:
        if len(self._unsent) + len(data) <= UNSENT_LIMIT:
            self._unsent += data
        if self._unsent:
            with contextlib.suppress(BlockingIOError):
                self._unsent = self._unsent[os.write(self._master, self._unsent) :]


def write_atomically(path: Path, document: dict[str, Any]) -> None:
    """Write JSON beside its target and rename it: a reader never sees half a file."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    temporary.write_text(json.dumps(document), encoding="utf-8")
    temporary.replace(path)


def main() -> None:
    """Print one JSON line with the port, serve until SIGTERM or the end of standard input, write the log."""
    configuration, log_path = _parse_arguments()
    server = PseudoTerminalServer(EmulatedFirmware(configuration))
    with _termination_descriptor() as termination:
        greeting = {
            "port": server.path,
            "simulated": True,
            "host_ns_at_device_zero": server.host_ns_at_device_zero,
        }
        sys.stdout.write(json.dumps(greeting) + "\n")
        sys.stdout.flush()
        server.serve([termination, sys.stdin.fileno()])
    server.close()
    if log_path is not None:
        write_atomically(log_path, server.log())


@contextlib.contextmanager
def _termination_descriptor() -> Iterator[int]:
    """A descriptor that can be read once SIGTERM or SIGINT has come."""
    reader, writer = socket.socketpair()
    with reader, writer:
        writer.setblocking(False)
        signal.set_wakeup_fd(writer.fileno())
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: None)
        yield reader.fileno()
        signal.set_wakeup_fd(-1)


def _parse_arguments() -> tuple[DeviceConfiguration, Path | None]:
    parser = argparse.ArgumentParser(prog="firmware_link.emulator", description=__doc__)
    parser.add_argument("--actuators", type=int, default=2, help="number of actuators, 1 to 255")
    parser.add_argument("--lease-ms", type=int, default=LONGEST_LEASE_MS, help="longest lease that it grants, in ms")
    parser.add_argument("--log", type=Path, help="where to write what it did, as JSON, when it ends")
    arguments = parser.parse_args()
    try:
        return DeviceConfiguration(secrets.randbits(32), arguments.actuators, arguments.lease_ms), arguments.log
    except ValueError as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
