"""End to end: link, pyserial, a real pseudo-terminal, the emulator process, and its log."""

import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from firmware_link.drive_log import Cause, Outcome, ReceivedFrame
from firmware_link.emulator import read_log, run_emulator
from firmware_link.errors import LinkError
from firmware_link.link import Link
from firmware_link.link_values import LinkConfiguration, LinkState
from firmware_link.messages import ChannelDrive, DeviceState, encode_drive
from firmware_link.serial_port import LowLatency, SerialPort, path_of
from firmware_link.session import Session
from firmware_link.synthesis import synthesise

# Only against an endless test: the machine may be slow.
PATIENCE_S = 60.0


def run_until(session: Session, condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end_s
        session.exchange()
        select.select([session.port], [session.port] if session.wants_to_write() else [], [], 0.005)


def process_exists(process_id: int) -> bool:
    try:
        os.kill(process_id, 0)
    except ProcessLookupError:
        return False
    return True


def test_a_drive_reaches_the_actuators_of_another_process() -> None:
    with run_emulator(number_of_actuators=2) as emulator, SerialPort(emulator.port) as port:
        assert port.low_latency is LowLatency.UNSUPPORTED
        link = Link(LinkConfiguration(2, handshake_timeout_s=PATIENCE_S))
        session = Session(link, port, time.monotonic_ns)
        session.connect()
        run_until(session, lambda: link.state is LinkState.READY)
        bounds = link.clock.offset_bounds(time.monotonic_ns())
        # The emulator cuts its clock to whole microseconds.
        assert bounds.lower_ns - 1000 <= -emulator.host_ns_at_device_zero <= bounds.upper_ns + 1000

        assert link.capabilities is not None
        resolution_hz = link.capabilities.frequency_resolution_hz
        link.set_drive(encode_drive([ChannelDrive(60, 1.0, 0.0), ChannelDrive(60, 0.5, 1.0)], resolution_hz))
        run_until(session, lambda: link.status is not None and link.status.state is DeviceState.DRIVING)
        link.stop(time.monotonic_ns())
        run_until(session, lambda: link.state is LinkState.STOPPED)
        log = emulator.stop()

    first, last = log.events[0], log.events[-1]
    assert (first.cause, first.sequence) == (Cause.SET, link.drive_sequence)
    assert ReceivedFrame(first.device_time_us, "SET", link.drive_sequence or 0, Outcome.ACCEPTED) in log.received
    # A stall of this machine may end the lease before the stop comes.
    assert last.cause in (Cause.STOP, Cause.LEASE_EXPIRED)
    assert log.counters["crc"] == log.counters["framing"] == log.counters["length"] == 0
    waveform = synthesise(log.events, 0, last.device_time_us + 100_000, 8000)
    assert 0 < np.abs(waveform).max() <= 1.0
    assert not waveform[-100:].any()


def test_no_emulator_outlives_an_exception() -> None:
    with pytest.raises(RuntimeError, match="as planned"), run_emulator() as emulator:
        assert process_exists(emulator.process_id)
        raise RuntimeError("as planned")
    assert not process_exists(emulator.process_id)


def test_a_bad_request_is_reported_when_starting() -> None:
    with pytest.raises(LinkError, match="did not start"), run_emulator(number_of_actuators=0):
        pass


def test_a_port_is_exclusive() -> None:
    with run_emulator() as emulator, SerialPort(emulator.port), pytest.raises(LinkError, match="cannot open"):
        SerialPort(emulator.port)


def test_an_unplugged_port_is_a_link_error() -> None:
    with run_emulator() as emulator, SerialPort(emulator.port) as port:
        session = Session(Link(LinkConfiguration(2)), port, time.monotonic_ns)
        session.connect()
        emulator.stop()
        with pytest.raises(LinkError, match="is gone"):
            run_until(session, lambda: False)
        assert session.link.state is LinkState.DISCONNECTED


def test_a_missing_port_is_named() -> None:
    with pytest.raises(LinkError, match="no serial port '/dev/nowhere'"):
        path_of("/dev/nowhere")


@pytest.mark.parametrize("by_signal", [False, True])
def test_the_process_ends_with_its_input_or_a_signal_and_leaves_its_log(by_signal: bool, tmp_path: Path) -> None:
    log_path = tmp_path / "log.json"
    command = [sys.executable, "-m", "firmware_link.emulator", "--actuators", "3", "--log", str(log_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        assert json.loads(process.stdout.readline())["simulated"] is True
        if by_signal:
            process.send_signal(signal.SIGTERM)
        else:
            process.stdin.close()
        assert process.wait(PATIENCE_S) == 0
    assert read_log(log_path).number_of_actuators == 3
    assert [path.name for path in tmp_path.iterdir()] == ["log.json"]
