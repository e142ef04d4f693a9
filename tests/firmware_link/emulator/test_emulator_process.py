"""End to end: link, pyserial, a real pseudo-terminal, the emulator's process, and its log."""

import errno
import os
import select
import signal
import time
from collections.abc import Callable
from typing import Any

import pytest

from firmware_link.emulator.drive_log import Cause, Outcome, ReceivedFrame
from firmware_link.emulator.emulator_process import EmulatorLog, RunningEmulator, run_emulator
from firmware_link.emulator.pty import open_pseudo_terminal
from firmware_link.host.link import Link
from firmware_link.host.link_values import LinkConfiguration, LinkState
from firmware_link.host.serial_port import ReopeningPort, SerialPort
from firmware_link.host.session import Session
from firmware_link.protocol.drive_words import ChannelDrive, encode_drive
from firmware_link.protocol.link_errors import LinkError
from firmware_link.protocol.messages import DeviceState
from tests.firmware_link.driving_host import LEASE_MS, host_process, strike
from tests.firmware_link.law_host import CLICKS

machine = pytest.mark.machine
# Only against an endless test: the machine may be slow.
PATIENCE_S = 60.0


def run_until(session: Session, condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end_s
        session.exchange()
        select.select([session.port], [session.port] if session.wants_to_write() else [], [], 0.005)


def reopened(port_that_stays: ReopeningPort[SerialPort]) -> tuple[SerialPort, Session]:
    """The port once it is there, and a session over it that is ready."""
    while (port := port_that_stays.poll(time.monotonic_ns())) is None:
        time.sleep(0.01)
    configuration = LinkConfiguration(2, handshake_timeout_s=PATIENCE_S, basis=CLICKS.basis)
    session = Session(Link(configuration), port, time.monotonic_ns)
    session.connect()
    run_until(session, lambda: session.link.state is LinkState.READY)
    return port, session


def log_when_over(emulator: RunningEmulator) -> EmulatorLog:
    while (log := emulator.log()).events[-1].cause is Cause.SET:
        time.sleep(0.005)
    return log


@machine
def test_a_drive_reaches_another_process_whose_port_is_exclusive_and_comes_back_under_another_name() -> None:
    with run_emulator() as emulator:
        reopening = ReopeningPort(lambda: SerialPort(emulator.stable_port))
        port, session = reopened(reopening)
        name, link = os.ttyname(port.fileno()), session.link
        with pytest.raises(LinkError, match="cannot open"):
            SerialPort(emulator.port)
        bounds = link.clock.offset_bounds(time.monotonic_ns())
        # The emulator cuts its clock to whole microseconds.
        assert bounds.lower_ns - 1000 <= -emulator.host_ns_at_device_zero <= bounds.upper_ns + 1000
        assert link.capabilities is not None
        boot_id, resolution_hz = link.capabilities.boot_id, link.capabilities.frequency_resolution_hz
        drive = encode_drive([ChannelDrive(60, 1.0, 0.0), ChannelDrive(60, 0.5, 1.0)], resolution_hz)

        emulator.unplug()
        with pytest.raises(LinkError, match="is gone"):
            run_until(session, lambda: False)
        assert link.state is LinkState.DISCONNECTED
        reopening.lose(time.monotonic_ns())
        port, session = reopened(reopening)
        link = session.link
        assert os.ttyname(port.fileno()) != name
        assert link.capabilities is not None and link.capabilities.boot_id == boot_id

        link.set_drive(drive)
        run_until(session, lambda: link.status is not None and link.status.state is DeviceState.DRIVING)
        link.stop(time.monotonic_ns())
        run_until(session, lambda: link.state is LinkState.STOPPED)
        os.kill(emulator.process_id, signal.SIGTERM)
        log = emulator.stop()
    assert log.number_of_actuators == 2, "a signal ends the process in order, and its log is its last word"
    driven = next(event for event in log.events if event.cause is Cause.SET)
    assert driven.sequence == link.drive_sequence
    assert ReceivedFrame(driven.device_time_us, "SET", driven.sequence or 0, Outcome.ACCEPTED) in log.received
    assert log.events[-1].cause is Cause.STOP
    assert log.counters["crc"] == log.counters["framing"] == log.counters["length"] == 0


@machine
def test_the_port_of_a_host_that_is_killed_is_let_go_and_a_stopped_one_keeps_it_and_is_silent() -> None:
    with run_emulator() as emulator:
        for how, cause in (("killed", Cause.HUNG_UP), ("stopped", Cause.LEASE_EXPIRED)):
            with host_process(emulator.port, how) as (host, drives):
                assert drives
                strike(host, how)
                log = log_when_over(emulator)
            last_us = max(frame.device_time_us for frame in log.received if frame.message == "SET")
            assert log.events[-1].cause is cause
            assert log.events[-1].device_time_us <= last_us + 1_000 * LEASE_MS, how
        emulator.reboot()
        assert len(emulator.log().earlier) == 1


def test_a_machine_without_pseudo_terminals_is_told_what_is_missing_and_how_to_have_it() -> None:
    def fails(*_: object) -> Any:
        raise OSError(errno.ENOENT, "No such file or directory")

    with pytest.raises(LinkError, match=r"/dev/ptmx.*No such file.*mount devpts"):
        open_pseudo_terminal(fails)
    ends = os.pipe()
    with pytest.raises(LinkError, match=r"/dev/pts.*No such file.*mount devpts"):
        open_pseudo_terminal(lambda: ends, fails)
    with pytest.raises(OSError, match="Bad file"):
        os.fstat(ends[0])
