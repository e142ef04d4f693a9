"""The loop from reports to an emulated firmware: in virtual time, and once through a real pseudo-terminal."""

from __future__ import annotations

import ctypes
import struct
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar

import pytest

from engine.device import Device
from engine.effects import Effect, Effects, Rule, Segment, Trigger
from engine.effects.rules import burst
from engine.loop import (
    Clock,
    Dispatcher,
    Loop,
    Observer,
    Observers,
    RingWriter,
    Stage,
    SystemClock,
    Timing,
    Trace,
    connect,
    open_pipeline,
)
from engine.loop.fast.session import FastLink, FastSession
from engine.loop.fast.table import with_fast_table
from engine.render import Renderer, Rendering, link_configuration
from engine.table import ClickEntry, Entry
from engine.table.click import choose_bank, played_at
from engine.touch import state_index
from engine.touch.digitizer import RELEASE_AFTER_NS
from engine.touch.sources import Source
from engine.touch.sources.playback import Playback
from engine.touch.sources.recording import Recording, Report, read_recording
from firmware_link.emulator import Cause, DeviceConfiguration, DriveEvent, EmulatedFirmware
from firmware_link.emulator.process import run_emulator
from firmware_link.host.link import Link
from firmware_link.host.link_values import LinkState
from firmware_link.host.reopening import ReopeningPort
from firmware_link.host.serial_port import SerialPort
from firmware_link.host.session import Session
from firmware_link.protocol.errors import LinkError, LinkLostError
from firmware_link.protocol.messages import DeviceState
from tests.engine.loop.fast.virtual_fast_path import Packets, VirtualFastPath
from tests.engine.made_entries import LEVEL_DB, entry_of, states_of
from tests.engine.shared_recordings import recording_params
from tests.engine.touch.descriptors import CONTACT_COUNT, application, finger

RUNS_BOTH_WAYS = True
MS = 1_000_000
DEVICE = Device.read(Path(__file__).parents[3] / "tables" / "devices" / "reference-a.toml")
DESCRIPTOR = application(finger(), finger(), CONTACT_COUNT)
BIT_RATE_HZ = 1_000_000
# Only against an endless handshake: the machine may be slow.
PATIENCE_S = 60.0

Touch = tuple[int, float]
"""Contact id and place, as a fraction of the bar."""


def entry_for(*zones: int, quiet: Sequence[int] = (), level_db: float = LEVEL_DB) -> Entry:
    """An entry whose frequency tells its felt zones apart: 100 Hz, and 1, 2, 4, 8, 16 Hz for zones I to V.

    0.25 Hz more where something is quiet, 0.5 Hz more at another level.
    """
    frequency_hz = 100.0 + sum(2**zone for zone in zones) + 0.25 * bool(quiet) + 0.5 * (level_db != LEVEL_DB)
    states = states_of(DEVICE, zones, quiet)
    return entry_of(DEVICE, states, frequencies_hz=(frequency_hz,) * 2, wanted_level_db=level_db)


ENTRIES = [entry_for(*zones) for zones in ((0,), (1,), (2,), (3,), (4,), (0, 2), (1, 3))]
BURSTS = Effects((Rule(Trigger.TOUCH, burst(LEVEL_DB, 50)),))
HELD = Effects((Rule(Trigger.TOUCH, Effect("held", (Segment(None, LEVEL_DB),))),))


def index_of(*zones: int, quiet: Sequence[int] = ()) -> int:
    return state_index(states_of(DEVICE, zones, quiet))


def report(*touches: Touch, lifted: Sequence[int] = ()) -> bytes:
    """One frame of up to two contacts in one report, of those that touch and those that have just lifted."""
    slots = [struct.pack("<BBHH", 3, contact_id, round(1000 * place), 500) for contact_id, place in touches]
    slots += [struct.pack("<BBHH", 0, contact_id, 0, 500) for contact_id in lifted]
    return b"\x01" + b"".join(slots).ljust(12, b"\0") + bytes([len(slots)])


def recording_of(*frames: tuple[float, bytes]) -> Recording:
    """Reports with their times in seconds."""
    reports = tuple(Report(index, time_s, data) for index, (time_s, data) in enumerate(frames))
    return Recording("virtual digitizer", 3, 0, 0, DESCRIPTOR, reports)


def held(start_s: float, stop_s: float, *touches: Touch) -> list[tuple[float, bytes]]:
    """A frame each 8 ms while fingers rest."""
    return [(start_s + 0.008 * i, report(*touches)) for i in range(round((stop_s - start_s) / 0.008))]


@dataclass
class VirtualLine:
    """A port, the clock, and an emulated firmware behind them; time passes only in `wait`."""

    delay_ns: int = 300_000
    takes_bytes: bool = True
    loses_power: bool = False
    """With the cable."""
    is_mute: bool = False
    firmware: EmulatedFirmware = field(default_factory=lambda: EmulatedFirmware(DeviceConfiguration(0x5EED)))
    time_ns: int = 5_000 * MS

    def __post_init__(self) -> None:
        self._to_device: list[tuple[int, bytes]] = []
        self._to_host: list[tuple[int, bytes]] = []
        self.stall_at_ns: int | None = None
        self.stall_ns = 400 * MS
        self.waits = 0
        self.cable_pulled_ns: int | None = None
        self.cable_back_ns = 0
        self.is_open = True
        self.booted_ns = 0
        self.earlier_logs: list[DriveEvent] = []
        self.openings_ns: list[int] = []

    def now_ns(self) -> int:
        return self.time_ns

    def fileno(self) -> int:
        return -1

    @property
    def is_plugged(self) -> bool:
        return self.cable_pulled_ns is None or self.time_ns < self.cable_pulled_ns

    def open(self) -> VirtualLine:
        self.openings_ns.append(self.time_ns)
        if not self.is_plugged and self.time_ns < self.cable_back_ns:
            raise LinkError("no serial port 'bar'")
        self.cable_pulled_ns, self.is_open = None, True
        return self

    def close(self) -> None:
        self.is_open = False

    def write(self, data: bytes) -> int:
        self._check_cable()
        if not self.takes_bytes:
            return 0
        self._to_device.append((self.time_ns + self.delay_ns, data))
        return len(data)

    def _check_cable(self) -> None:
        assert self.is_open
        if not self.is_plugged:
            raise LinkLostError("bar is gone")

    def read(self) -> bytes:
        self._check_cable()
        data = b"".join(data for time_ns, data in self._to_host if time_ns <= self.time_ns)
        self._to_host = [item for item in self._to_host if item[0] > self.time_ns]
        return data

    def wait(self, until_ns: int | None, readable: Sequence[int], writable: Sequence[int]) -> None:
        assert (readable, writable) in ([((-1,), ()), ((-1,), (-1,))] if self.is_open else [((), ())])
        self.waits += 1
        assert until_ns is not None or self._to_host or self._to_device, "the loop would wait for ever"
        end_ns = until_ns if until_ns is not None else self.time_ns + 1_000 * MS
        if self.stall_at_ns is not None and self.time_ns >= self.stall_at_ns:
            self.stall_at_ns, end_ns = None, self.time_ns + self.stall_ns
            while self.time_ns < end_ns:
                self._run_to(min(end_ns, self._next_ns()))
        while self.time_ns < end_ns and not self._is_readable():
            self._run_to(min([end_ns, self._next_ns(), *(time_ns for time_ns, _ in self._to_host)]))

    def _is_readable(self) -> bool:
        return self.is_open and (not self.is_plugged or any(time_ns <= self.time_ns for time_ns, _ in self._to_host))

    def _next_ns(self) -> int:
        deadline_us = self.firmware.next_deadline_us()
        times_ns = [time_ns for time_ns, _ in self._to_device]
        if self.cable_pulled_ns is not None and self.is_plugged:
            times_ns.append(self.cable_pulled_ns)
        if deadline_us is not None:
            times_ns.append(self.booted_ns + 1000 * deadline_us)
        return max(self.time_ns + 1, min(times_ns, default=self.time_ns + 1_000 * MS))

    def _run_to(self, end_ns: int) -> None:
        while self._to_device and self._to_device[0][0] <= end_ns:
            time_ns, data = self._to_device.pop(0)
            self._answer(self.firmware.receive(data, self._device_us(time_ns)), time_ns)
        self._answer(self.firmware.advance(self._device_us(end_ns)), end_ns)
        was_plugged, self.time_ns = self.is_plugged, end_ns
        if was_plugged and not self.is_plugged:
            self._pull_cable()

    def _pull_cable(self) -> None:
        self.firmware.hang_up(self._device_us(self.time_ns))
        self._to_device, self._to_host = [], []
        if self.loses_power:
            self.earlier_logs += self.firmware.drive_log
            self.firmware, self.booted_ns = EmulatedFirmware(DeviceConfiguration(0xB007)), self.time_ns

    def _device_us(self, time_ns: int) -> int:
        return (time_ns - self.booted_ns) // 1000

    def _answer(self, data: bytes, time_ns: int) -> None:
        if data and not self.is_mute and self.is_plugged:
            self._to_host.append((time_ns + self.delay_ns, data))


@dataclass
class Rig:
    """A run over a virtual line."""

    recording: Recording
    line: VirtualLine = field(default_factory=VirtualLine)
    speed: float | None = 1.0
    reconnect: bool = False
    reopening: ReopeningPort[VirtualLine] | None = None
    bit_rate_hz: int = BIT_RATE_HZ
    effects: Effects = HELD
    ring: RingWriter | None = None
    entries: Sequence[Entry] = tuple(ENTRIES)
    clicks: Sequence[ClickEntry] = ()
    library: ClassVar[ctypes.CDLL | None] = None
    """Of the fast path: the loop's tests hold with it and without."""

    def __post_init__(self) -> None:
        self.trace, timing = Trace(), Timing()
        self.latency = timing.latency
        configuration = link_configuration(DEVICE, self.bit_rate_hz)
        session = FastSession(FastLink(configuration), self.line, self.line.now_ns)
        capabilities = connect(session, self.line)
        bank, waveforms = choose_bank(self.clicks, capabilities)
        if bank is not None:
            configuration = replace(configuration, bank=bank)
            session = FastSession(FastLink(configuration), self.line, self.line.now_ns)
            connect(session, self.line)
        self.session = session
        self.start_ns = self.line.time_ns
        source = Packets(self.recording, self.speed)
        levels_db = self.effects.levels_db
        by_level = {level: [e for e in self.entries if e.wanted_level_db == level] for level in levels_db}
        clicks = {level: [played_at(click, level) for click in self.clicks] for level in levels_db}
        self.renderer = Renderer(by_level, DEVICE, capabilities, clicks=clicks, waveforms=waveforms)
        pipeline = open_pipeline(source, DEVICE, self.effects, self.renderer, self.line.now_ns)
        dispatcher = Dispatcher(session, self.line.now_ns)
        self.observers = Observers(self.trace, timing, self.ring)
        edges: tuple[Source, Clock, Observer] = (source, self.line, self.observers)
        self.rendering = with_fast_table(Rendering(DEVICE, self.renderer, configuration, b"", 0), capabilities)
        if self.library is not None:
            fast = VirtualFastPath(
                self.library, source, pipeline, dispatcher, self.line, self.effects, self.rendering, self.observers
            )
            edges = (fast.source, fast, fast)
        self.loop = Loop(pipeline, dispatcher, *edges, reconnect=self.reconnect, reopening=self.reopening)

    def run(self) -> Rig:
        self.loop.run()
        assert self.session.fast_counters.mispredicted == 0
        return self

    @property
    def log(self) -> list[DriveEvent]:
        return self.line.firmware.drive_log

    def states(self) -> list[int]:
        return [change.state for change in self.trace]

    def played(self) -> list[float]:
        """Frequency of the first actuator at each change of the drive, 0 for silence."""
        return [round(event.channels[0].frequency_hz * bool(event.channels[0].amplitude), 2) for event in self.log]


def test_a_touch_is_felt_and_a_lift_is_silence() -> None:
    rig = Rig(recording_of(*held(0.0, 0.2, (1, 0.1)), (0.2, report(lifted=[1])))).run()
    assert rig.states() == [index_of(0), 0]
    assert rig.played() == [101.0, 0.0]
    assert rig.line.firmware.state is DeviceState.LATCHED
    assert rig.session.link.state is LinkState.STOPPED
    counters = rig.loop.counters
    assert (counters.reports, counters.frames, counters.state_changes, counters.commands) == (26, 26, 2, 2)


def test_each_state_change_is_found_in_the_log_by_its_sequence() -> None:
    frames = [
        *held(0.0, 0.1, (1, 0.1)),
        *held(0.1, 0.2, (1, 0.5)),
        *held(0.2, 0.3, (1, 0.9)),
        (0.3, report(lifted=[1])),
    ]
    rig = Rig(recording_of(*frames)).run()
    assert [event.sequence for event in rig.log] == [change.drive_sequence for change in rig.trace]
    assert len(rig.trace) == 4
    for change, event in zip(rig.trace, rig.log, strict=True):
        assert change.report_index is not None
        due_ns = rig.start_ns + round(1e9 * rig.recording.reports[change.report_index].time_s)
        assert change.time_ns == due_ns
        assert 0 <= 1000 * event.device_time_us - due_ns - rig.line.delay_ns < MS


def test_several_fingers_make_one_state_and_leave_one_by_one() -> None:
    both = [(1, 0.1), (2, 0.5)]
    frames = [*held(0.0, 0.1, (1, 0.1)), *held(0.1, 0.2, *both), (0.2, report((2, 0.5), lifted=[1]))]
    rig = Rig(recording_of(*frames, (0.208, report(lifted=[2])))).run()
    assert rig.states() == [index_of(0), index_of(0, 2), index_of(2), 0]
    assert rig.played() == [101.0, 105.0, 104.0, 0.0]
    length_m = DEVICE.bar.length_m
    positions_m = [change.finger_positions_m for change in rig.trace]
    assert positions_m[1] == pytest.approx((0.1 * length_m, 0.5 * length_m), abs=1e-12)
    assert positions_m[3] == ()


def test_a_resting_finger_keeps_its_drive_by_renewals_alone() -> None:
    rig = Rig(recording_of(*held(0.0, 2.0, (1, 0.3)), (2.0, report(lifted=[1])))).run()
    assert rig.played() == [102.0, 0.0]
    assert [event.cause for event in rig.log] == [Cause.SET, Cause.SET]
    assert rig.session.link.counters.renewed > 100


@pytest.mark.parametrize("speed", [1.0, 3.0, None])
def test_a_lost_release_falls_silent_within_150_ms(speed: float | None) -> None:
    frames = held(0.0, 0.2, (1, 0.1))
    rig = Rig(recording_of(*frames), speed=speed).run()
    assert rig.states() == [index_of(0), 0]
    assert rig.trace[-1].report_index is None
    assert rig.log[-1].channels[0].amplitude == 0
    paces = {None: 0.0, 1.0: 1.0, 3.0: 1 / 3}
    last_report_ns = rig.start_ns + round(1e9 * frames[-1][0] * paces[speed])
    assert 1000 * rig.log[-1].device_time_us - last_report_ns <= 150 * MS


def test_a_pause_in_a_recording_played_at_once_still_releases() -> None:
    frames = [(0.0, report((1, 0.1))), (0.5, report((1, 0.1))), (0.508, report(lifted=[1]))]
    assert Rig(recording_of(*frames), speed=None).run().states() == [index_of(0), 0, index_of(0), 0]


def test_the_latest_state_wins_on_a_slow_line() -> None:
    places = [0.1, 0.3, 0.5, 0.7, 0.9]
    frames = [(0.0005 * i, report((1, place))) for i, place in enumerate(places)]
    rig = Rig(recording_of(*frames, *held(0.008, 0.1, (1, 0.9))), bit_rate_hz=115_200).run()
    assert rig.states() == [index_of(zone) for zone in range(5)] + [0]
    sequences = [change.drive_sequence for change in rig.trace]
    assert None in sequences
    assert None not in sequences[-2:]
    assert [event.sequence for event in rig.log] == [sequence for sequence in sequences if sequence is not None]
    assert rig.loop.counters.commands + sequences.count(None) == rig.loop.counters.state_changes
    assert rig.played()[-2:] == [116.0, 0.0]


def test_reports_that_a_stall_held_up_are_all_taken_and_only_the_last_state_is_sent() -> None:
    frames = [(0.001 * i, report((1, 0.1 + 0.2 * (i // 10 % 5)))) for i in range(100)]
    rig = Rig(recording_of(*frames))
    rig.line.stall_at_ns, rig.line.stall_ns = rig.start_ns + 15 * MS, 60 * MS
    rig.run()
    assert rig.loop.counters.frames == 100
    assert rig.states() == [*map(index_of, (0, 1, 2, 3, 4, 0, 1, 2, 3, 4)), 0]
    after_stall = [change for change in rig.trace if change.time_ns == rig.start_ns + 75 * MS]
    assert [change.state for change in after_stall] == [index_of(zone) for zone in (2, 3, 4, 0, 1, 2)]
    assert [change.drive_sequence is None for change in after_stall] == [True] * 5 + [False]
    assert rig.played() == [101.0, 102.0, 0.0, 104.0, 108.0, 116.0, 0.0]
    assert rig.line.firmware.counters.stale == 0


def test_a_state_without_entry_is_silent_and_counted() -> None:
    frames = [*held(0.0, 0.1, (1, 0.1)), *held(0.1, 0.2, (1, 0.1), (2, 0.9)), (0.2, report(lifted=[1, 2]))]
    rig = Rig(recording_of(*frames)).run()
    assert rig.played() == [101.0, 0.0]
    assert rig.renderer.unknown_states == 1


def test_an_effect_ends_at_its_time_without_a_report() -> None:
    rig = Rig(recording_of((0.0, report((1, 0.1))), (0.1, report(lifted=[1]))), effects=BURSTS).run()
    assert rig.states() == [index_of(0), index_of(quiet=[0]), 0]
    first, second, _ = rig.trace
    assert (first.level_db, second.level_db) == (LEVEL_DB, None)
    assert second.report_index is None
    assert 0 <= second.time_ns - first.time_ns - 50 * MS < MS
    assert rig.played() == [101.0, 0.0]
    assert abs(1000 * (rig.log[1].device_time_us - rig.log[0].device_time_us) - 50 * MS) < MS


def test_a_resting_finger_is_quiet_while_another_one_feels() -> None:
    entries = [entry_for(0), entry_for(2, quiet=[0])]
    frames = [*held(0.0, 0.2, (1, 0.1)), *held(0.2, 0.4, (1, 0.1), (2, 0.5)), (0.4, report(lifted=[1, 2]))]
    rig = Rig(recording_of(*frames), effects=BURSTS, entries=entries).run()
    assert rig.states() == [
        index_of(0),
        index_of(quiet=[0]),
        index_of(2, quiet=[0]),
        index_of(quiet=[0, 2]),
        0,
    ]
    assert rig.played() == [101.0, 0.0, 104.25, 0.0]
    assert rig.renderer.unknown_states == 0


def test_each_segment_of_an_envelope_is_a_command_at_its_level() -> None:
    envelope = (Segment(30 * MS, 30.0), Segment(30 * MS, None), Segment(None, LEVEL_DB))
    effects = Effects((Rule(Trigger.TOUCH, Effect("steps", envelope)),))
    entries = [entry_for(1), entry_for(1, level_db=30.0)]
    frames = [*held(0.0, 0.2, (1, 0.3)), (0.2, report(lifted=[1]))]
    rig = Rig(recording_of(*frames), effects=effects, entries=entries).run()
    assert [change.level_db for change in rig.trace] == [30.0, None, LEVEL_DB, None]
    assert rig.played() == [102.5, 0.0, 102.0, 0.0]


def test_a_change_that_keeps_the_drive_sends_nothing() -> None:
    places = [0.1, 0.3, 0.5, 0.7, 0.9]
    frames = [frame for i, place in enumerate(places) for frame in held(0.1 * i, 0.1 * (i + 1), (1, place))]
    rig = Rig(recording_of(*frames, (0.5, report(lifted=[1]))), effects=BURSTS).run()
    assert rig.states() == [index_of(0), *(index_of(quiet=[zone]) for zone in range(5)), 0]
    assert [change.drive_sequence is None for change in rig.trace] == [False, False, *[True] * 5]
    assert rig.loop.counters.commands == 2
    assert rig.latency.count == 1


def test_a_lift_is_played_to_its_end_though_the_source_has_ended() -> None:
    effects = Effects((Rule(Trigger.LIFT, burst(LEVEL_DB, 80)),))
    rig = Rig(recording_of(*held(0.0, 0.1, (1, 0.1)), (0.1, report(lifted=[1]))), effects=effects).run()
    assert rig.states() == [index_of(quiet=[0]), index_of(0), 0]
    on, off = (change.time_ns for change in rig.trace[1:])
    assert 0 <= off - on - 80 * MS < MS


def test_a_lost_finger_rests_no_longer_than_it_was_seen() -> None:
    effects = Effects((Rule(Trigger.HOLD, burst(LEVEL_DB, 50), after_ns=150 * MS),))
    frames = [(0.0, report((1, 0.1))), (1.0, report((1, 0.1))), (1.008, report(lifted=[1]))]
    for speed in (1.0, None):
        assert Rig(recording_of(*frames), speed=speed, effects=effects).run().states() == [index_of(quiet=[0]), 0] * 2


def test_a_host_that_stalled_for_seconds_hears_the_device_before_it_calls_it_silent() -> None:
    rig = Rig(recording_of(*held(0.0, 4.0, (1, 0.1)), (4.0, report(lifted=[1]))), reconnect=True)
    rig.line.stall_at_ns, rig.line.stall_ns = rig.start_ns + 300 * MS, 3_000 * MS
    rig.run()
    assert rig.loop.counters.reconnects == 1
    assert rig.states() == [index_of(0), 0]
    assert rig.played() == [101.0, 0.0, 101.0, 0.0]


def test_after_a_stall_effects_are_caught_up_with_in_order_and_the_last_state_is_sent() -> None:
    rig = Rig(recording_of(*held(0.0, 0.3, (1, 0.1)), (0.3, report(lifted=[1]))), effects=BURSTS)
    rig.line.stall_at_ns, rig.line.stall_ns = rig.start_ns + 20 * MS, 100 * MS
    rig.run()
    assert rig.states() == [index_of(0), index_of(quiet=[0]), 0]
    assert rig.trace[1].time_ns >= rig.start_ns + 120 * MS


def test_nothing_touched_sends_nothing_but_silence() -> None:
    rig = Rig(recording_of((0.0, report(lifted=[1])), (1.0, report(lifted=[1])))).run()
    assert (rig.log, rig.trace, rig.loop.counters.commands) == ([], [], 0)
    assert rig.line.firmware.state is DeviceState.LATCHED


def test_a_stop_request_silences_a_finger_that_still_touches() -> None:
    rig = Rig(recording_of(*held(0.0, 10.0, (1, 0.1))))
    stop = threading.Event()
    event_at_ns = rig.start_ns + 100 * MS

    class Watch:
        def is_set(self) -> bool:
            return stop.is_set() or rig.line.time_ns > event_at_ns

    rig.loop.run(Watch())
    assert rig.line.time_ns < event_at_ns + 100 * MS
    assert rig.states() == [index_of(0), 0]
    assert rig.trace[-1].finger_positions_m != ()
    assert rig.log[-1].channels[0].amplitude == 0
    assert rig.line.firmware.state is DeviceState.LATCHED


def stalled(*, reconnect: bool) -> Rig:
    """The host stops for 400 ms under a finger: the device falls silent by itself, then latches."""
    rig = Rig(recording_of(*held(0.0, 1.0, (1, 0.1)), (1.0, report(lifted=[1]))), reconnect=reconnect)
    rig.line.stall_at_ns = rig.start_ns + 300 * MS
    return rig


def test_a_device_that_latched_ends_the_run_with_final_counters() -> None:
    rig = stalled(reconnect=False)
    with pytest.raises(LinkError, match="start the run again"):
        rig.run()
    assert [event.cause for event in rig.log] == [Cause.SET, Cause.LEASE_EXPIRED]
    assert rig.line.firmware.state is DeviceState.LATCHED
    assert rig.session.link.state is LinkState.DISCONNECTED
    assert rig.loop.counters.commands >= 1
    assert len(rig.trace) == rig.loop.counters.state_changes


def test_with_reconnect_the_state_of_the_moment_is_sent_anew() -> None:
    rig = stalled(reconnect=True).run()
    assert rig.loop.counters.reconnects == 1
    assert rig.played() == [101.0, 0.0, 101.0, 0.0]
    assert rig.line.firmware.counters.trips == 1


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
    assert rig.states() == [index_of(0), index_of(1), index_of(2), 0]
    assert [change.drive_sequence is None for change in rig.trace] == [False, True, False, False]
    log = [*line.earlier_logs, *rig.log]
    frequencies_hz = [event.channels[0].frequency_hz for event in log if event.cause is Cause.SET]
    assert frequencies_hz[:2] == pytest.approx([101.0, 104.0])
    assert [event.cause for event in log] == [Cause.SET, Cause.HUNG_UP, Cause.SET, Cause.SET]
    assert line.firmware.state is DeviceState.LATCHED
    assert line.firmware.counters.stale == 0


def test_a_lost_port_is_looked_for_with_growing_pauses() -> None:
    rig = unplugged(*held(0.0, 6.0, (1, 0.1)), back_s=5.0).run()
    since_ms = [(time_ns - rig.start_ns - 300 * MS) // MS for time_ns in rig.line.openings_ns]
    assert since_ms == [100, 200, 400, 800, 1600, 3200, 5200]
    assert rig.played() == [101.0, 0.0, 101.0, 0.0]


def test_nothing_is_played_after_the_return_that_ended_before_it() -> None:
    frames = [*held(0.0, 0.4, (1, 0.1)), (0.4, report(lifted=[1])), (1.5, report(lifted=[1]))]
    rig = unplugged(*frames).run()
    assert rig.loop.counters.reconnects == 1
    assert rig.states() == [index_of(0), 0]
    assert rig.played() == [101.0, 0.0]


def test_a_device_that_answers_no_more_is_greeted_again_on_its_port_opened_anew() -> None:
    rig = unplugged(*held(0.0, 4.0, (1, 0.1)), (4.0, report(lifted=[1])))
    rig.line.cable_pulled_ns = None
    mute_ns, line = rig.start_ns + 300 * MS, rig.line

    class Mute:
        """Takes the voice of the device away for 1.5 s; the port stays."""

        def is_set(self) -> bool:
            line.is_mute = mute_ns <= line.time_ns < mute_ns + 1_500 * MS
            return False

    rig.loop.run(Mute())
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

    class Exchange:
        """Puts another device there while the cable is out."""

        def is_set(self) -> bool:
            if not rig.line.is_open:
                rig.line.firmware = stranger
            return False

    with pytest.raises(LinkError, match="another device answered"):
        rig.loop.run(Exchange())
    assert stranger.drive_log == []
    assert stranger.state is DeviceState.IDLE


def test_a_request_to_stop_is_seen_while_the_port_is_away() -> None:
    rig = unplugged(*held(0.0, 10.0, (1, 0.1)), back_s=9.0)
    stop_ns = rig.start_ns + 4_000 * MS

    class Watch:
        def is_set(self) -> bool:
            return rig.line.time_ns >= stop_ns

    rig.loop.run(Watch())
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


def test_latency_counts_from_when_the_report_was_due() -> None:
    rig = Rig(recording_of(*held(0.0, 0.2, (1, 0.1)), (0.2, report(lifted=[1])))).run()
    stamps_ns = rig.latency.stamps_ns()
    assert rig.latency.count == 2
    assert stamps_ns[0, Stage.AVAILABLE] == rig.start_ns
    # Virtual time stands still inside a pass; the first command waits for the end of the handshake on the line.
    assert (stamps_ns[:, : Stage.WRITTEN] == stamps_ns[:, :1]).all()
    summary = rig.latency.summarise(Stage.COMMAND, Stage.WRITTEN)
    assert summary is not None
    assert (summary.count, summary.p50_ns) == (2, 0)
    assert 0 < summary.max_ns < MS


def test_virtual_time_is_real_time_in_little_time() -> None:
    rig = Rig(recording_of(*held(0.0, 20.0, (1, 0.1)))).run()
    assert rig.line.time_ns - rig.start_ns >= 20_000 * MS + RELEASE_AFTER_NS - 8 * MS
    assert rig.loop.counters.frames == 2500


EVERY_TRIGGER = Effects(
    (
        Rule(Trigger.TOUCH, burst(LEVEL_DB, 50)),
        Rule(Trigger.DRAG, Effect("texture", (Segment(20 * MS, 30.0), Segment(None, LEVEL_DB))), every_m=5e-3),
        Rule(Trigger.HOLD, Effect("purr", (Segment(None, LEVEL_DB),)), after_ns=200 * MS),
        Rule(Trigger.LIFT, burst(30.0, 20)),
    )
)


@pytest.mark.parametrize("path", recording_params("touch", "*.hid"))
def test_a_real_recording_gives_the_same_states_and_levels_at_any_speed(path: Path) -> None:
    recording = read_recording(path)
    rigs = [Rig(recording, speed=speed, effects=EVERY_TRIGGER) for speed in (1.0, 7.0, None)]
    first, *others = [[(c.state, c.level_db) for c in rig.run().trace] for rig in rigs]
    assert others == [first] * 2
    assert first == [] or first[-1] == (0, None)
    assert {rig.loop.counters.reports for rig in rigs} == {len(recording.reports)}


def test_a_touch_reaches_the_emulator_of_another_process() -> None:
    frames = [*held(0.0, 0.2, (1, 0.1)), *held(0.2, 0.4, (1, 0.5)), (0.4, report(lifted=[1]))]
    clock, trace, timing = SystemClock(), Trace(), Timing()
    with run_emulator(number_of_actuators=2) as emulator, SerialPort(emulator.port) as port:
        link = Link(replace(link_configuration(DEVICE), handshake_timeout_s=PATIENCE_S))
        session = Session(link, port, clock.now_ns)
        renderer = Renderer({LEVEL_DB: ENTRIES}, DEVICE, connect(session, clock))
        source, dispatcher = Playback(recording_of(*frames)), Dispatcher(session, clock.now_ns)
        pipeline = open_pipeline(source, DEVICE, HELD, renderer, clock.now_ns)
        # A stall of this machine may latch the device: the run goes on.
        loop = Loop(pipeline, dispatcher, source, clock, Observers(trace, timing), reconnect=True)
        loop.run()
        log = emulator.stop()
    assert [change.state for change in trace] == [index_of(0), index_of(2), 0]
    applied = {event.sequence for event in log.events if event.cause is Cause.SET}
    sent = {change.drive_sequence for change in trace} - {None}
    assert loop.counters.reconnects or (sent and sent <= applied)
    assert not log.events[-1].channels[0].amplitude
    summary = timing.latency.summarise()
    assert summary is not None
    assert summary.count == loop.counters.commands
    assert 0 < summary.p50_ns <= summary.max_ns
