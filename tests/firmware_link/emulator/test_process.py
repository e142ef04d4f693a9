"""End to end: link, pyserial, a real pseudo-terminal, the emulator process, and its log."""

import os
import select
import signal
import time
from collections.abc import Callable

import numpy as np
import pytest

from firmware_link.child import ChildError
from firmware_link.emulator import Cause, Outcome, ReceivedFrame, synthesise
from firmware_link.emulator.fault_plan import FaultPlanError
from firmware_link.emulator.process import run_emulator
from firmware_link.host.link import Link
from firmware_link.host.link_values import LinkConfiguration, LinkState
from firmware_link.host.reopening import ReopeningPort
from firmware_link.host.serial_port import LowLatency, SerialPort, path_of
from firmware_link.host.session import Session
from firmware_link.protocol.errors import LinkError
from firmware_link.protocol.messages import ChannelDrive, DeviceState, encode_drive
from tests.firmware_link.clicks import Clicks

pytestmark = pytest.mark.machine

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
    with pytest.raises(ChildError, match="number_of_actuators"), run_emulator(number_of_actuators=0):
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


def test_a_signal_ends_the_process_in_order_and_its_log_is_its_last_word() -> None:
    with run_emulator(number_of_actuators=3) as emulator:
        os.kill(emulator.process_id, signal.SIGTERM)
        assert emulator.stop().number_of_actuators == 3


def test_an_emulator_that_was_killed_has_no_log() -> None:
    with run_emulator() as emulator:
        os.kill(emulator.process_id, signal.SIGKILL)
        with pytest.raises(ChildError, match="the emulator was ended by SIGKILL"):
            emulator.stop()


def test_a_port_that_comes_back_under_another_name_is_found_by_the_one_that_stays() -> None:
    with run_emulator() as emulator:
        reopening = ReopeningPort(lambda: SerialPort(emulator.stable_port))
        names, boots = [], []
        for _ in range(2):
            while (port := reopening.poll(time.monotonic_ns())) is None:
                time.sleep(0.01)
            names.append(os.ttyname(port.fileno()))
            session = Session(Link(LinkConfiguration(2, handshake_timeout_s=PATIENCE_S)), port, time.monotonic_ns)
            session.connect()
            run_until(session, lambda link=session.link: link.state is LinkState.READY)  # type: ignore[misc]
            assert session.link.capabilities is not None
            boots.append(session.link.capabilities.boot_id)
            emulator.unplug()
            with pytest.raises(LinkError, match="is gone"):
                run_until(session, lambda: False)
            reopening.lose(time.monotonic_ns())
        assert names[0] != names[1]
        assert boots[0] == boots[1]


def test_a_reboot_begins_another_log_and_keeps_the_one_before() -> None:
    with run_emulator() as emulator, SerialPort(emulator.port) as port:
        boots = []
        for _ in range(2):
            session = Session(Link(LinkConfiguration(2, handshake_timeout_s=PATIENCE_S)), port, time.monotonic_ns)
            session.connect()
            run_until(session, lambda link=session.link: link.state is LinkState.READY)  # type: ignore[misc]
            assert session.link.capabilities is not None
            boots.append(session.link.capabilities.boot_id)
            emulator.reboot()
        log = emulator.log()
    assert boots[0] != boots[1]
    assert [bool(earlier.received) for earlier in log.earlier] == [True, True]
    assert log.received == ()
    assert log.faults["reboots"] == 2
    assert log.host_ns_at_device_zero > log.earlier[1].host_ns_at_device_zero > emulator.host_ns_at_device_zero


def test_faults_of_a_text_are_injected_and_counted() -> None:
    with run_emulator(faults="duplicate=1", seed=5) as emulator, SerialPort(emulator.port) as port:
        session = Session(Link(LinkConfiguration(2, handshake_timeout_s=PATIENCE_S)), port, time.monotonic_ns)
        session.connect()
        run_until(session, lambda: session.link.state is LinkState.READY)
        log = emulator.stop()
    assert log.faults["to_device.duplicated"] == log.faults["to_device.frames"] >= 6
    assert log.counters["ok"] == log.faults["to_device.intact"]
    with pytest.raises(FaultPlanError), run_emulator(faults="duplicat=1"):
        pass


def test_a_waveform_reaches_the_actuators_of_another_process() -> None:
    clicks = Clicks(1000, [np.outer(np.sin(np.linspace(0, np.pi, 41)).round(9), [1.0, -1.0])])
    configuration = LinkConfiguration(2, basis=clicks.basis, bit_rate_hz=2_000_000, handshake_timeout_s=PATIENCE_S)
    with run_emulator() as emulator, SerialPort(emulator.port) as port:
        session = Session(Link(configuration), port, time.monotonic_ns)
        session.connect()
        run_until(session, lambda: session.link.state is LinkState.READY)
        log = emulator.log()
        # A stall of this machine may make one stale.
        while not log.events:
            session.link.set_play(clicks.encoded(0))
            end_s = time.monotonic() + 0.1
            run_until(session, lambda end_s=end_s: time.monotonic() > end_s)  # type: ignore[misc]
            log = emulator.log()
        event = log.events[0]
        assert event.cause is Cause.PLAY
        waveform = synthesise(log.events, event.device_time_us, event.device_time_us + 41_000, 8000)
        assert waveform.max() == pytest.approx(1.0, abs=0.01)
