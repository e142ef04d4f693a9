"""Laws of the link, over an emulated firmware and a line with delays and losses, in virtual time."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_link.emulator.device_state import DeviceConfiguration
from firmware_link.emulator.drive_log import Cause
from firmware_link.emulator.firmware import EmulatedFirmware
from firmware_link.host.link import SILENCE_NS, Link
from firmware_link.host.link_values import Armed, Greeted, LinkConfiguration, LinkState, Stopped
from firmware_link.protocol.basis import Basis
from firmware_link.protocol.drive_words import ChannelDrive, encode_drive
from firmware_link.protocol.framing import encode_message
from firmware_link.protocol.link_errors import LinkError, MessageError
from firmware_link.protocol.messages import DeviceState, Fault, FaultCode, Features, Log, LogCode
from tests.firmware_link.law_host import Clicks, greeting
from tests.firmware_link.strategies import RESOLUTION_HZ, unhurried
from tests.firmware_link.virtual_rig import BOOT_ID, VirtualRig, decode_messages
from tests.tools.virtual import MS


def drive(amplitude: float, number_of_actuators: int = 2) -> bytes:
    return encode_drive([ChannelDrive(60, amplitude)] * number_of_actuators, RESOLUTION_HZ)


CLICKS = Clicks(2000, [np.outer(np.sin(np.linspace(0, np.pi, 61)).round(9), [1.0, -0.5]), np.zeros((601, 2))])
BASIS = CLICKS.basis


def connected(basis: Basis | None = None, **settings: int) -> VirtualRig:
    rig = VirtualRig(LinkConfiguration(2, bit_rate_hz=1_000_000, basis=basis), **settings)  # type: ignore[arg-type]
    rig.connect()
    return rig


@settings(unhurried, max_examples=12)
@given(st.integers(0, 20_000_000), st.sampled_from([0, 3, 7]), st.sampled_from([None, BASIS]))
def test_the_handshake_ends_ready_whatever_delay_and_loss_with_a_basis_and_without(
    delay_ns: int, drop_every: int, basis: Basis | None
) -> None:
    rig = connected(basis, delay_ns=delay_ns, drop_every=drop_every)
    assert rig.firmware.state is DeviceState.ARMED
    kinds = [type(item) for item in rig.events]
    assert kinds.count(Greeted) == 1
    assert kinds.count(Armed) == 1
    bounds = rig.link.clock.offset_bounds(rig.now_ns)
    assert bounds.lower_ns <= -rig.device_start_ns <= bounds.upper_ns


def test_a_busy_line_gets_one_set_at_a_time_and_always_the_newest() -> None:
    rig = VirtualRig(LinkConfiguration(2, bit_rate_hz=115_200))
    rig.connect()
    rig.line.written.clear()
    steps = 400
    for step in range(steps):
        rig.link.set_drive(drive(step / steps))
        rig.step()
    spent_ns = rig.line.written[-1][0] - rig.line.written[0][0]
    bits = 10 * sum(len(data) for _, data in rig.line.written[:-1])
    assert bits <= spent_ns * 115_200e-9
    assert rig.link.counters.sent + rig.link.counters.coalesced >= steps - 1
    rig.run(10 * MS)
    assert rig.firmware.drive_log[-1].channels[0].amplitude == pytest.approx((steps - 1) / steps, abs=1e-4)


@pytest.mark.parametrize("drop_every", [0, 3])
def test_a_drive_is_renewed_as_long_as_the_loop_runs_though_frames_are_lost_and_not_longer(drop_every: int) -> None:
    rig = connected(drop_every=drop_every)
    rig.link.set_drive(drive(1.0))
    rig.run(1000 * MS)
    assert rig.firmware.counters.trips == 0
    assert (len(rig.firmware.drive_log), rig.firmware.state) == (1, DeviceState.DRIVING)
    rig.is_host_alive = False
    died_us = rig.line.device_us()
    rig.run(300 * MS)
    assert rig.firmware.drive_log[-1].cause is Cause.LEASE_EXPIRED
    assert rig.firmware.drive_log[-1].device_time_us - died_us <= 40_000 + 1000
    assert rig.firmware.state is DeviceState.LATCHED


@pytest.mark.parametrize("losing", [0, 1])
def test_silence_ends_the_drive_even_where_its_frame_is_lost_and_the_device_stays_armed(losing: int) -> None:
    rig = connected()
    rig.link.set_drive(drive(1.0))
    rig.run(20 * MS)
    rig.losing = losing
    rig.link.set_silent()
    rig.run(42 * MS)
    assert rig.losing == 0
    assert rig.firmware.state is DeviceState.ARMED
    rig.run(1000 * MS)
    assert (rig.firmware.state, rig.link.state) == (DeviceState.ARMED, LinkState.READY)
    assert rig.link.counters.renewed >= 10


def test_the_applied_sequence_comes_back_and_counters_of_both_sides_agree() -> None:
    rig = connected()
    rig.link.set_drive(drive(1.0))
    rig.run(12 * MS)
    assert rig.link.status is not None
    assert rig.link.status.applied_sequence == rig.link.drive_sequence == rig.firmware.received[-1].sequence
    rig.run(488 * MS)
    rig.link.set_silent()
    rig.run(500 * MS)
    assert rig.firmware.counters.applied == rig.link.counters.sent + rig.link.counters.renewed
    assert rig.firmware.framing_counters.ok == len(rig.line.written)


def test_stop_is_repeated_until_acknowledged_and_nothing_drives_after() -> None:
    rig = connected(drop_every=2)
    rig.link.set_drive(drive(1.0))
    rig.run(20 * MS)
    rig.link.stop(rig.now_ns)
    rig.run_until(lambda: rig.link.state is LinkState.STOPPED)
    assert Stopped() in rig.events
    rig.link.set_drive(drive(1.0))
    rig.run(1000 * MS)
    assert rig.firmware.state is DeviceState.LATCHED
    assert rig.link.counters.dropped == 1


def test_a_fault_of_before_the_session_is_acknowledged_and_does_not_end_it() -> None:
    rig = VirtualRig()
    rig.connect()
    rig.run(20 * MS)
    rig.line.close()
    rig.link.disconnect()
    rig.line.open()
    # The device repeats its fault each 100 ms; the handshake takes less.
    rig.run(30 * MS)
    rig.connect()
    rig.events.clear()
    rig.run(300 * MS)
    assert rig.link.state is LinkState.READY
    assert not [event for event in rig.events if isinstance(event, Fault)]
    assert rig.link.counters.faults == 1
    assert rig.link.status is not None
    assert (rig.link.status.state, rig.link.status.fault) == (DeviceState.ARMED, FaultCode.NONE)


@pytest.mark.parametrize("fault", [FaultCode.SILENT_HOST, FaultCode.DRIVEN_TOO_LONG])
def test_a_fault_ends_the_session_and_is_acknowledged(fault: FaultCode) -> None:
    rig = VirtualRig(LinkConfiguration(2, bit_rate_hz=1_000_000, longest_drive_s=1))
    rig.connect()
    rig.link.set_drive(drive(1.0))
    rig.is_host_alive = fault is not FaultCode.SILENT_HOST
    rig.run(300 * MS)
    rig.is_host_alive = True
    rig.run(1000 * MS)
    assert [item.fault for item in rig.events if isinstance(item, Fault)] == [fault]
    assert (rig.firmware.state, rig.link.state) == (DeviceState.LATCHED, LinkState.STOPPED)
    assert rig.link.status is not None
    assert rig.link.status.fault is FaultCode.NONE
    rig.connect()
    assert rig.firmware.state is DeviceState.ARMED


def test_a_rebooted_device_is_never_driven_and_the_host_notices() -> None:
    rig = connected()
    rig.link.set_drive(drive(1.0))
    rig.run(100 * MS)
    rig.line.server.reboot(rig.now_ns)
    with pytest.raises(LinkError, match="no answer"):
        rig.run(2 * SILENCE_NS)
    assert rig.firmware.drive_log == []
    assert rig.link.state is LinkState.DISCONNECTED


@pytest.mark.parametrize(
    ("change", "wanted", "remedy"),
    [
        ({"version_major": 2}, {}, "protocol 2.1, this host 3.1.*install the firmware"),
        ({"schema_hash": 1}, {}, "schema 00000001.*install the firmware"),
        ({"number_of_actuators": 1}, {}, "drives 1 actuators, 2 are needed"),
        ({"longest_lease_ms": 0}, {}, "no lease.*set longest_lease_ms"),
        ({"features": Features(0)}, {"basis": BASIS}, "plays no clicks: connect another device"),
        ({"basis_capacity_bytes": 100}, {"basis": BASIS}, "has 2664 bytes, the device holds 100: take"),
        ({"longest_waveform_ms": 29}, {"basis": BASIS}, "lasts 300 ms, .* at most 29: shorten it"),
        ({}, {"basis": Clicks(9, [np.zeros((3, 3))]).basis}, "for 3 actuators, not 2"),
    ],
)
def test_a_device_that_does_not_fit_is_refused(change: dict[str, Any], wanted: dict[str, Any], remedy: str) -> None:
    device = EmulatedFirmware(DeviceConfiguration(BOOT_ID))
    hello, *_ = decode_messages(device.receive(encode_message(greeting(0), 1), 0))
    changes = {"full_scales_pm": (1,) * change.get("number_of_actuators", 2)} | change
    link = Link(LinkConfiguration(2, **wanted))
    link.connect(0)
    with pytest.raises(LinkError, match=remedy):
        link.receive(encode_message(replace(hello, **changes), 1), 1000)
    assert link.state is LinkState.DISCONNECTED


def test_no_device_is_an_error_with_a_remedy() -> None:
    link = Link(LinkConfiguration(2, handshake_timeout_s=0.5))
    link.connect(0)
    link.set_play(CLICKS.encoded(0))
    assert (link.counters.dropped, bool(link.outgoing(0))) == (1, True)
    link.poll(499 * MS)
    with pytest.raises(LinkError, match="greeting: check that it is powered"):
        link.poll(500 * MS)
    assert link.next_deadline_ns() is None


@pytest.mark.parametrize(("limits", "felt"), [(None, [0.9, 0.9, 0, 0]), ((0.25, 0.75), [0.25, 0.75, 0, 0])])
def test_amplitude_limits_bind_and_spare_actuators_stay_silent(
    limits: tuple[float, ...] | None, felt: list[float]
) -> None:
    spare = DeviceConfiguration(BOOT_ID, number_of_actuators=4)
    rig = VirtualRig(LinkConfiguration(2, amplitude_limits=limits), spare)
    rig.connect()
    rig.link.set_drive(drive(0.9))
    rig.run(10 * MS)
    amplitudes = [channel.amplitude for channel in rig.firmware.drive_log[-1].channels]
    assert amplitudes == pytest.approx(felt, abs=1e-4)
    with pytest.raises(LinkError, match="a drive of 30 bytes; the device takes 24"):
        rig.link.set_drive(drive(0.5, 5))
    with pytest.raises(ValueError, match="1 amplitude limits for 2 actuators"):
        LinkConfiguration(2, amplitude_limits=(1.0,))
    with pytest.raises(MessageError):
        LinkConfiguration(2, amplitude_limits=(1.0, 1.5))


def frames_of(rig: VirtualRig, name: str) -> int:
    return sum(frame.message == name for frame in rig.firmware.received)


def test_a_basis_that_the_device_holds_is_not_sent_again() -> None:
    rig = connected(BASIS)
    sent = frames_of(rig, "BASIS_CHUNK")
    assert sent == -(-len(BASIS.data) // 192)
    rig.connect()
    assert frames_of(rig, "BASIS_CHUNK") == sent
    rig.link.set_play(CLICKS.encoded(0))
    rig.run(10 * MS)
    assert rig.firmware.state is DeviceState.DRIVING


def test_a_long_transfer_on_a_slow_line_does_not_end_the_patience() -> None:
    basis = Clicks(20_000, [np.zeros((16_000, 2))]).basis
    rig = VirtualRig(LinkConfiguration(2, bit_rate_hz=115_200, basis=basis, handshake_timeout_s=1.0))
    started_ns = rig.now_ns
    rig.connect()
    assert rig.now_ns - started_ns > 5_000 * MS


@pytest.mark.parametrize("losing", [0, 1])
def test_a_long_click_is_kept_alive_and_a_lost_one_latches_nothing(losing: int) -> None:
    rig = connected(BASIS)
    rig.run(70 * MS)
    rig.losing = losing
    rig.link.set_play(CLICKS.encoded(1, 0.5))
    rig.run(1000 * MS)
    played = [event.waveform for event in rig.firmware.drive_log if event.waveform is not None]
    assert [len(waveform.samples) for waveform in played] == [601] * (1 - losing)
    assert [waveform.amplitude for waveform in played] == pytest.approx([0.5] * (1 - losing), abs=1e-4)
    assert rig.firmware.counters.trips == 0
    assert rig.link.counters.kept_alive >= 3
    assert (rig.firmware.state, rig.link.state) == (DeviceState.ARMED, LinkState.READY)


def test_drives_clicks_and_silence_share_one_slot() -> None:
    rig = connected(BASIS)
    rig.link.set_play(CLICKS.encoded(0))
    rig.link.set_drive(drive(0.3))
    rig.link.set_drive(drive(0.4))
    rig.run(10 * MS)
    rig.link.set_drive(drive(0.6))
    rig.link.set_play(CLICKS.encoded(1))
    rig.run(10 * MS)
    assert len(rig.firmware.drive_log) == 2
    rig.link.set_silent()
    rig.run(10 * MS)
    causes = [(event.cause, round(event.channels[0].amplitude, 2)) for event in rig.firmware.drive_log]
    assert causes == [(Cause.SET, 0.4), (Cause.PLAY, 0.0), (Cause.SET, 0.0)]
    assert rig.firmware.state is DeviceState.ARMED
    assert rig.link.counters.coalesced == 3


def test_clicks_in_a_hurry_wait_for_their_turn_and_the_latest_wins() -> None:
    rig = connected(BASIS)
    for index in range(60):
        rig.link.set_play(CLICKS.encoded(index % 2))
        rig.run(MS)
    rig.run(10 * MS)
    assert rig.firmware.counters.refused == 0
    assert 8 <= frames_of(rig, "PLAY") <= 12
    last = rig.firmware.drive_log[-1].waveform
    assert last is not None
    assert len(last.samples) == 601


def test_a_click_of_another_basis_is_refused_at_once() -> None:
    other = Clicks(2000, [np.zeros((61, 2))])
    with pytest.raises(LinkError, match="made of another basis than this link's"):
        connected(BASIS).link.set_play(other.encoded(0))
    with pytest.raises(LinkError, match="made of another basis than this link's"):
        connected().link.set_play(CLICKS.encoded(0))


def test_what_the_device_says_of_itself_comes_in_si_units_and_with_words() -> None:
    rig = connected(BASIS)
    capabilities = rig.link.capabilities
    assert capabilities is not None
    assert capabilities.frequency_resolution_hz == pytest.approx(0.01)
    assert capabilities.frequency_maximum_hz == pytest.approx(655.35)
    assert capabilities.full_scales_m == pytest.approx((0.52e-6, 0.52e-6))
    logs = [item for item in rig.events if isinstance(item, Log)]
    assert [log.code for log in logs] == [LogCode.BOOTED, LogCode.BASIS_TAKEN]
    assert "reset cause 0" in logs[0].text
    assert f"{BASIS.hash:#010x}" in logs[1].text
