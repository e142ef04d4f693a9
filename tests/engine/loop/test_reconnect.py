"""A loop whose device stops, or whose port is lost: what comes back, and what ends the run."""

from dataclasses import replace

import pytest

from firmware_link.emulator.device_state import DeviceConfiguration
from firmware_link.emulator.drive_log import Cause
from firmware_link.emulator.firmware import EmulatedFirmware
from firmware_link.host.link_values import LinkState
from firmware_link.host.serial_port import ReopeningPort
from firmware_link.protocol.link_errors import LinkError, LinkLostError
from firmware_link.protocol.messages import DeviceState
from tests.engine.loop.rig import Rig, Watch, held, index_of, recording_of, report
from tests.tools.virtual import MS, VirtualLine

RUNS_BOTH_WAYS = True


def test_a_device_that_latched_ends_the_run_with_final_counters() -> None:
    """The host stops for 400 ms under a finger: the device falls silent by itself, then latches."""
    rig = Rig(recording_of(*held(0.0, 1.0, (1, 0.1)), (1.0, report(lifted=[1]))))
    rig.line.stall_at_ns = rig.start_ns + 300 * MS
    with pytest.raises(LinkError, match="start the run again"):
        rig.run()
    assert [event.cause for event in rig.log] == [Cause.SET, Cause.LEASE_EXPIRED]
    assert rig.line.firmware.state is DeviceState.LATCHED
    assert rig.session.link.state is LinkState.DISCONNECTED
    assert rig.loop.counters.commands >= 1
    assert len(rig.trace) == rig.loop.counters.state_changes


def test_a_silence_that_was_due_during_a_reconnect_is_sent_after_it() -> None:
    back = [(0.507, report((1, 0.1))), (0.51, report(lifted=[1])), (0.6, report(lifted=[1]))]
    rig = Rig(recording_of(*held(0.0, 0.3, (1, 0.1)), *back), reconnect=True)
    rig.line.stall_at_ns = rig.start_ns + 100 * MS
    rig.run()
    assert rig.loop.counters.reconnects == 1
    assert rig.states()[-1] == 0
    assert rig.trace[-1].drive_sequence is not None
    assert rig.line.firmware.state is DeviceState.LATCHED


def unplugged(*frames: tuple[float, bytes], back_s: float = 0.75, loses_power: bool = False) -> Rig:
    """The cable is pulled 0.3 s after the start of a run that waits for it."""
    line = VirtualLine(loses_power=loses_power)
    rig = Rig(recording_of(*frames), line, reconnect=True, reopening=ReopeningPort(line.open, line))
    line.cable_pulled_ns = rig.start_ns + 300 * MS
    line.cable_back_ns = rig.start_ns + round(1e9 * back_s)
    return rig


@pytest.mark.parametrize("loses_power", [False, True])
def test_a_device_that_was_unplugged_plays_on_with_the_state_of_the_moment(loses_power: bool) -> None:
    """Touches are read all the while: in I before, in II and III while the cable is out, still in III after."""
    moves = [*held(0.0, 0.4, (1, 0.1)), *held(0.4, 0.6, (1, 0.3)), *held(0.6, 1.5, (1, 0.5))]
    rig = unplugged(*moves, (1.5, report(lifted=[1])), loses_power=loses_power).run()
    line, counters = rig.line, rig.loop.counters
    assert (counters.losses, counters.reconnects) == (1, 1)
    assert [(opened_ns - rig.start_ns) // MS for opened_ns in line.openings_ns] == [400, 500, 700, 1100]
    assert rig.states() == [index_of(0), index_of(1), index_of(2), 0]
    assert [change.drive_sequence is None for change in rig.trace] == [False, True, False, False]
    frequencies_hz = [event.channels[0].frequency_hz for event in rig.log if event.cause is Cause.SET]
    assert frequencies_hz[:2] == pytest.approx([101.0, 104.0])
    assert [event.cause for event in rig.log] == [Cause.SET, Cause.HUNG_UP, Cause.SET, Cause.SET]
    assert line.firmware.state is DeviceState.LATCHED
    assert line.firmware.counters.stale == 0


def test_a_device_that_answers_no_more_is_greeted_again_on_its_port_opened_anew() -> None:
    rig = unplugged(*held(0.0, 4.0, (1, 0.1)), (4.0, report(lifted=[1])))
    rig.line.cable_pulled_ns = None
    mute_ns, line = rig.start_ns + 300 * MS, rig.line

    def mute() -> bool:
        """Take the voice of the device away for 1.5 s; the port stays."""
        line.is_mute = mute_ns <= line.time_ns < mute_ns + 1_500 * MS
        return False

    rig.loop.run(Watch(mute))
    assert rig.loop.counters.losses == 1
    assert rig.states() == [index_of(0), 0]
    assert rig.played()[-2:] == [101.0, 0.0]


def test_without_a_way_to_open_it_again_a_lost_port_ends_the_run() -> None:
    rig = unplugged(*held(0.0, 1.0, (1, 0.1)))
    rig = replace(rig, line=VirtualLine(), reopening=None)
    rig.line.cable_pulled_ns = rig.start_ns + 300 * MS
    with pytest.raises(LinkLostError, match="is gone"):
        rig.run()
    assert rig.line.openings_ns == []
    assert rig.session.link.state is LinkState.DISCONNECTED
    assert len(rig.trace) == rig.loop.counters.state_changes


def test_another_device_on_the_port_ends_the_run() -> None:
    rig = unplugged(*held(0.0, 2.0, (1, 0.1)), loses_power=True)
    stranger = EmulatedFirmware(DeviceConfiguration(1, number_of_actuators=3))

    def exchange() -> bool:
        """Put another device there while the cable is out."""
        if not rig.line.is_open:
            rig.line.firmware = stranger
        return False

    with pytest.raises(LinkError, match="another device answered"):
        rig.loop.run(Watch(exchange))
    assert stranger.drive_log == []
    assert stranger.state is DeviceState.IDLE


def test_a_request_to_stop_is_seen_while_the_port_is_away() -> None:
    rig = unplugged(*held(0.0, 10.0, (1, 0.1)), back_s=9.0)
    stop_ns = rig.start_ns + 4_000 * MS
    rig.loop.run(Watch(lambda: rig.line.time_ns >= stop_ns))
    assert rig.line.time_ns <= stop_ns + 100 * MS
    assert rig.states() == [index_of(0), 0]


@pytest.mark.parametrize(("is_mute", "remedy"), [(False, "disarmed itself"), (True, "no answer")])
def test_a_line_that_takes_nothing_ends_in_a_link_error_without_spinning(is_mute: bool, remedy: str) -> None:
    rig = Rig(recording_of(*held(0.0, 10.0, (1, 0.1))))
    rig.line.takes_bytes, rig.line.is_mute, rig.line.waits = False, is_mute, 0
    with pytest.raises(LinkError, match=remedy):
        rig.run()
    assert rig.line.time_ns - rig.start_ns < 1_500 * MS
    assert rig.line.waits < 600
    assert rig.log == []
