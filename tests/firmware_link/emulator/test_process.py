"""End to end: link, pyserial, a real pseudo-terminal, the emulator's process, and its log."""

import os
import select
import signal
import time
from collections.abc import Callable

import pytest

from firmware_link.emulator import Cause, Outcome, ReceivedFrame
from firmware_link.emulator.fault_plan import FaultPlanError
from firmware_link.emulator.process import run_emulator
from firmware_link.host.link import Link
from firmware_link.host.link_values import LinkConfiguration, LinkState
from firmware_link.host.reopening import ReopeningPort
from firmware_link.host.serial_port import LowLatency, SerialPort
from firmware_link.host.session import Session
from firmware_link.protocol.errors import LinkError
from firmware_link.protocol.messages import ChannelDrive, DeviceState, encode_drive

machine = pytest.mark.machine
# Only against an endless test: the machine may be slow.
PATIENCE_S = 60.0


def run_until(session: Session, condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end_s
        session.exchange()
        select.select([session.port], [session.port] if session.wants_to_write() else [], [], 0.005)


def ready_session(port: SerialPort) -> Session:
    session = Session(Link(LinkConfiguration(2, handshake_timeout_s=PATIENCE_S)), port, time.monotonic_ns)
    session.connect()
    run_until(session, lambda: session.link.state is LinkState.READY)
    return session


@machine
def test_a_drive_reaches_the_actuators_of_another_process_whose_port_is_exclusive() -> None:
    with run_emulator(number_of_actuators=2) as emulator, SerialPort(emulator.port) as port:
        assert port.low_latency is LowLatency.UNSUPPORTED
        with pytest.raises(LinkError, match="cannot open"):
            SerialPort(emulator.port)
        session = ready_session(port)
        link = session.link
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
    assert last.cause is Cause.STOP
    assert log.counters["crc"] == log.counters["framing"] == log.counters["length"] == 0


@machine
def test_a_port_that_comes_back_under_another_name_is_found_by_the_one_that_stays() -> None:
    with run_emulator() as emulator:
        reopening = ReopeningPort(lambda: SerialPort(emulator.stable_port))
        names, boots = [], []
        for _ in range(2):
            while (port := reopening.poll(time.monotonic_ns())) is None:
                time.sleep(0.01)
            names.append(os.ttyname(port.fileno()))
            session = ready_session(port)
            assert session.link.capabilities is not None
            boots.append(session.link.capabilities.boot_id)
            emulator.unplug()
            with pytest.raises(LinkError, match="is gone"):
                run_until(session, lambda: False)
            assert session.link.state is LinkState.DISCONNECTED
            reopening.lose(time.monotonic_ns())
        assert names[0] != names[1]
        assert boots[0] == boots[1]


@machine
def test_a_signal_ends_the_process_in_order_and_its_log_is_its_last_word() -> None:
    with run_emulator(number_of_actuators=3) as emulator:
        os.kill(emulator.process_id, signal.SIGTERM)
        assert emulator.stop().number_of_actuators == 3


def test_faults_that_are_none_are_refused_before_anything_starts() -> None:
    with pytest.raises(FaultPlanError), run_emulator(faults="duplicat=1"):
        pass
