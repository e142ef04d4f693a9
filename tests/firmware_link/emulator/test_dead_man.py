"""Real processes: whatever becomes of a host that drives, the actuators are silent within lease and ramp."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from firmware_link.emulator import Cause, synthesise
from firmware_link.emulator.process import EmulatorLog, RunningEmulator, run_emulator
from firmware_link.host.serial_port import SerialPort
from firmware_link.protocol.framing import FrameDecoder, encode_message
from firmware_link.protocol.layout import Message
from firmware_link.protocol.messages import DeviceState, Fault, FaultCode, Status, TimeRequest, decode_body
from tests.firmware_link.driving_host import DRIVING, ENDED, LEASE_MS, PATIENCE_S, SLEW_PER_S

pytestmark = pytest.mark.machine

LEASE_US = 1_000 * LEASE_MS
RAMP_US = 1_000_000 // SLEW_PER_S
DISARM_US = 250_000
SAMPLE_RATE_HZ = 50_000.0
ROOT = Path(__file__).parents[3]


class DrivingHost:
    """The process, once it drives."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self.process = process
        assert self._line() == DRIVING

    def tell(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write("\n")
        self.process.stdin.flush()

    def end(self) -> str:
        """How its session ended, by its own words."""
        line = self._line()
        assert line.startswith(ENDED)
        return line

    def _line(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline().strip()


@contextmanager
def driving_host(emulator: RunningEmulator, how: str = "") -> Iterator[DrivingHost]:
    command = [sys.executable, "-m", "tests.firmware_link.driving_host", emulator.port, how]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, cwd=ROOT, stdin=pipe, stdout=pipe, text=True) as process:
        try:
            yield DrivingHost(process)
        finally:
            process.kill()


def kill(host: DrivingHost, _: RunningEmulator) -> None:
    host.process.kill()


def stop(host: DrivingHost, _: RunningEmulator) -> None:
    os.kill(host.process.pid, signal.SIGSTOP)


def tell(host: DrivingHost, _: RunningEmulator) -> None:
    host.tell()


def unplug(_: DrivingHost, emulator: RunningEmulator) -> None:
    emulator.unplug()


Blow = Callable[[DrivingHost, RunningEmulator], None]


@pytest.mark.parametrize(
    ("name", "blow", "cause", "fault"),
    [
        ("killed", kill, Cause.HUNG_UP, FaultCode.HUNG_UP),
        ("stopped", stop, Cause.LEASE_EXPIRED, FaultCode.SILENT_HOST),
        ("unplugged", unplug, Cause.HUNG_UP, FaultCode.HUNG_UP),
        ("wedged", tell, Cause.LEASE_EXPIRED, FaultCode.SILENT_HOST),
        ("loop", tell, Cause.LEASE_EXPIRED, FaultCode.SILENT_HOST),
    ],
)
def test_a_host_that_fails_leaves_no_drive(
    name: str, blow: Blow, cause: Cause, fault: FaultCode, capsys: pytest.CaptureFixture[str]
) -> None:
    with run_emulator() as emulator, driving_host(emulator, name) as host:
        blow_us = device_us(emulator)
        blow(host, emulator)
        log = log_when(emulator, lambda log: log.events[-1].cause is not Cause.SET)
        last_us = max(frame.device_time_us for frame in log.received if frame.message == "SET")
        wait_until(emulator, last_us + DISARM_US)
        log = emulator.log()
        silent_us = silent_from_us(log)
        # What is on the line when the host fails may be as old as a lease when it is applied.
        assert last_us <= blow_us + LEASE_US
        # A stall of this machine may end a lease before the line is known to be gone.
        assert log.events[-1].cause in (cause, Cause.LEASE_EXPIRED)
        assert silent_us <= last_us + LEASE_US + RAMP_US
        host.process.kill()
        host.process.wait()
        latched = ask_status(emulator)
        assert latched.state is DeviceState.LATCHED
        assert latched.fault in (fault, FaultCode.SILENT_HOST)
        assert emulator.log().events == log.events
    with capsys.disabled():
        later_ms = (silent_us - blow_us) / 1e3
        print(f"\n  host {name}: silent {later_ms:.1f} ms later, latched as {latched.fault.name}")  # noqa: T201


def test_a_host_that_wakes_up_again_does_not_drive_again() -> None:
    with run_emulator() as emulator, driving_host(emulator) as host:
        stop(host, emulator)
        log = log_when(emulator, lambda log: log.events[-1].cause is not Cause.SET)
        wait_until(emulator, log.received[-1].device_time_us + DISARM_US + 20_000)
        os.kill(host.process.pid, signal.SIGCONT)
        assert "stopped" in host.end()
        assert emulator.log().events == log.events


def test_a_silent_host_is_latched_a_quarter_second_after_its_last_frame() -> None:
    with run_emulator() as emulator, driving_host(emulator) as host:
        stop(host, emulator)
        log = log_when(emulator, lambda log: log.events[-1].cause is not Cause.SET)
        fresh_us = max(f.device_time_us for f in log.received if f.message == "SET")
        wait_until(emulator, fresh_us + DISARM_US)
        # The stopped process keeps the port to itself, but cannot read: listen beside it.
        terminal = os.open(emulator.port, os.O_RDWR | os.O_NOCTTY)
        fault = next(message for message in heard(lambda: os.read(terminal, 4096)) if isinstance(message, Fault))
        os.close(terminal)
        assert fault.fault is FaultCode.SILENT_HOST
        assert fault.device_time_us == fresh_us + DISARM_US


def device_us(emulator: RunningEmulator) -> int:
    return (time.monotonic_ns() - emulator.host_ns_at_device_zero) // 1_000


def wait_until(emulator: RunningEmulator, time_us: int) -> None:
    time.sleep(max(0, time_us - device_us(emulator)) / 1e6 + 0.02)


def log_when(emulator: RunningEmulator, fits: Callable[[EmulatorLog], bool]) -> EmulatorLog:
    end_s = time.monotonic() + PATIENCE_S
    while not fits(log := emulator.log()):
        assert time.monotonic() < end_s
        time.sleep(0.005)
    return log


def silent_from_us(log: EmulatorLog) -> float:
    """Device time from which every actuator stays at zero."""
    start_us = log.events[-1].device_time_us - 50_000
    moves = np.abs(synthesise(log.events, start_us, start_us + 150_000, SAMPLE_RATE_HZ)).max(axis=1)
    return float(start_us + (np.flatnonzero(moves)[-1] + 1) * 1e6 / SAMPLE_RATE_HZ)


def open_beside(emulator: RunningEmulator) -> SerialPort:
    """The port, also after the cable was pulled."""
    end_s = time.monotonic() + PATIENCE_S
    while not Path(emulator.stable_port).exists():
        assert time.monotonic() < end_s
        time.sleep(0.01)
    return SerialPort(str(Path(emulator.stable_port).resolve()))


def ask_status(emulator: RunningEmulator) -> Status:
    """The next status that the device tells; no greeting, which would release it."""
    with open_beside(emulator) as port:
        port.write(encode_message(TimeRequest(0), 0))
        return next(message for message in heard(port.read) if isinstance(message, Status))


def heard(read: Callable[[], bytes]) -> Iterator[Message]:
    decoder, end_s = FrameDecoder(), time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s:
        yield from (decode_body(item)[1] for item in decoder.receive(read()) if isinstance(item, bytes))
        time.sleep(0.005)
