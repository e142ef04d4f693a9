"""The loop from reports to an emulated firmware, its ring, clicks and measured fingers, in virtual time."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import pytest

from engine.effects.rules import DEFAULT_EFFECTS, Effect, Effects, Rule, Segment, Trigger, burst, click
from engine.loop.observer import Stage
from engine.loop.ring import Record, RingReader, RingWriter
from engine.steady.cases import MeasuredFinger
from engine.touch.sources.recording import read_recording
from firmware_link.emulator.device_state import DeviceConfiguration
from firmware_link.emulator.drive_log import Cause, DriveEvent
from firmware_link.host.link_values import Event, LinkState
from firmware_link.protocol.messages import DeviceState
from tests.engine.loop.rig import (
    BIT_RATE_HZ,
    BURSTS,
    DEVICE,
    HELD,
    Rig,
    Watch,
    held,
    index_of,
    recording_of,
    rendering_of,
    report,
)
from tests.engine.loop.test_pipeline import EVERY_TRIGGER
from tests.engine.loop.test_table_swap import Later
from tests.engine.made_table import LEVEL_DB, click_of, in_zones, made_clicks, number_of
from tests.engine.shared_recordings import recording_params
from tests.tools.virtual import MS, VirtualLine

RUNS_BOTH_WAYS = True


def test_a_touch_is_felt_kept_by_renewals_alone_and_a_lift_is_silence() -> None:
    rig = Rig(recording_of(*held(0.0, 2.0, (1, 0.1)), (2.0, report(lifted=[1])))).run()
    assert rig.states() == [index_of(0), 0]
    assert rig.played() == [101.0, 0.0] and [event.cause for event in rig.log] == [Cause.SET, Cause.SET]
    assert rig.session.link.counters.renewed > 100
    assert rig.line.firmware.state is DeviceState.LATCHED
    assert rig.session.link.state is LinkState.STOPPED
    counters = rig.loop.counters
    assert (counters.reports, counters.frames, counters.state_changes, counters.commands) == (251, 251, 2, 2)


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
    assert [state for state, change in zip(rig.states(), rig.trace, strict=True) if change in after_stall] == [
        index_of(zone) for zone in (2, 3, 4, 0, 1, 2)
    ]
    assert [change.drive_sequence is None for change in after_stall] == [True] * 5 + [False]
    assert rig.played() == [101.0, 102.0, 0.0, 104.0, 108.0, 116.0, 0.0]
    assert rig.line.firmware.counters.stale == 0


def test_fingers_that_are_one_to_the_bar_and_those_beyond_ten_are_counted() -> None:
    frames = [*held(0.0, 0.1, (1, 0.1), (2, 0.12)), (0.1, report(lifted=[1, 2]))]
    rig = Rig(recording_of(*frames)).run()
    assert (rig.loop.counters.joined, rig.loop.counters.left_out) == (1, 0)
    assert rig.steady.solved[0][0].is_felt == (True,)


@pytest.mark.parametrize("is_stalled", [False, True])
def test_each_segment_of_an_envelope_is_a_command_and_after_a_stall_the_last_is_sent(is_stalled: bool) -> None:
    envelope = (Segment(30 * MS, 30.0), Segment(30 * MS, None), Segment(None, LEVEL_DB))
    effects = Effects((Rule(Trigger.TOUCH, Effect("steps", envelope)),))
    rig = Rig(recording_of(*held(0.0, 0.2, (1, 0.3)), (0.2, report(lifted=[1]))), effects=effects)
    rig.line.stall_at_ns, rig.line.stall_ns = rig.start_ns + 20 * MS, 60 * MS * is_stalled
    rig.run()
    assert [change.level_db for change in rig.trace] == [30.0, None, LEVEL_DB, None]
    assert [change.drive_sequence is None for change in rig.trace] == [False, is_stalled, False, False]
    assert rig.played() == [102.5, 0.0, 102.0, 0.0]


def test_a_lift_is_played_to_its_end_though_the_source_has_ended() -> None:
    effects = Effects((Rule(Trigger.LIFT, burst(LEVEL_DB, 80)),))
    rig = Rig(recording_of(*held(0.0, 0.1, (1, 0.1)), (0.1, report(lifted=[1]))), effects=effects).run()
    assert rig.states() == [index_of(0), 0]
    on, off = rig.trace
    assert off.report_index is None and rig.latency.count == 1
    assert 0 <= off.time_ns - on.time_ns - 80 * MS < MS
    assert abs(1000 * (rig.log[1].device_time_us - rig.log[0].device_time_us) - 80 * MS) < MS


def test_a_lost_finger_rests_no_longer_than_it_was_seen() -> None:
    effects = Effects((Rule(Trigger.HOLD, burst(LEVEL_DB, 50), after_ns=150 * MS),))
    frames = [(0.0, report((1, 0.1))), (1.0, report((1, 0.1))), (1.008, report(lifted=[1]))]
    for speed in (1.0, None):
        assert Rig(recording_of(*frames), speed=speed, effects=effects).run().states() == []


class AttentiveLine(VirtualLine):
    """Says whether the port can be read; where it cannot, the stall of `stall_ns` comes only after that was found."""

    def wait(self, until_ns: int | None, readable: Sequence[int], writable: Sequence[int]) -> Sequence[int]:
        stall_at_ns, self.stall_at_ns = self.stall_at_ns, None
        super().wait(until_ns, readable, writable)
        found = readable if self.is_readable() else ()
        if stall_at_ns is None or self.time_ns < stall_at_ns or found:
            self.stall_at_ns = stall_at_ns
        else:
            self.stall()
        return found


@pytest.mark.parametrize("line_class", [VirtualLine, AttentiveLine])
def test_a_host_that_stalled_hears_the_device_before_it_calls_it_silent(line_class: type[VirtualLine]) -> None:
    """Also where it stalled after its port was found empty."""
    rig = Rig(recording_of(*held(0.0, 4.0, (1, 0.1)), (4.0, report(lifted=[1]))), line_class(), reconnect=True)
    rig.line.stall_at_ns, rig.line.stall_ns = rig.start_ns + 300 * MS, 3_000 * MS
    rig.run()
    assert rig.loop.counters.reconnects == rig.line.firmware.counters.trips == 1
    assert rig.states() == [index_of(0), 0]
    assert rig.played() == [101.0, 0.0, 101.0, 0.0]


def test_a_stop_request_silences_a_finger_that_still_touches() -> None:
    rig = Rig(recording_of(*held(0.0, 10.0, (1, 0.1))))
    event_at_ns = rig.start_ns + 100 * MS
    rig.loop.run(Watch(lambda: rig.line.time_ns > event_at_ns))
    assert rig.line.time_ns < event_at_ns + 100 * MS
    assert rig.states() == [index_of(0), 0]
    assert rig.trace[-1].touches
    assert rig.log[-1].channels[0].amplitude == 0
    assert rig.line.firmware.state is DeviceState.LATCHED


def test_latency_counts_from_when_the_report_was_due() -> None:
    rig = Rig(recording_of(*held(0.0, 0.2, (1, 0.1)), (0.2, report(lifted=[1])))).run()
    stamps_ns = rig.latency.rows_ns()
    assert rig.latency.count == 2
    assert stamps_ns[0, Stage.AVAILABLE] == rig.start_ns
    # Virtual time stands still inside a pass; the first command waits for the end of the handshake on the line.
    assert (stamps_ns[:, : Stage.WRITTEN] == stamps_ns[:, :1]).all()
    summary = rig.latency.summarise(Stage.COMMAND, Stage.WRITTEN)
    assert summary is not None
    assert (summary.count, summary.p50_ns) == (2, 0)
    assert 0 < summary.max_ns < MS


@pytest.mark.parametrize("path", recording_params("touch", "*.hid", long_but=2))
def test_a_real_recording_gives_the_same_states_and_levels_at_any_speed(path: Path) -> None:
    recording = read_recording(path)
    rigs = [Rig(recording, speed=speed, effects=EVERY_TRIGGER) for speed in (7.0, None)]
    first, *others = [[(c.placement, c.level_db) for c in rig.run().trace] for rig in rigs]
    assert others == [first]
    assert first == [] or first[-1] == (None, None)
    assert {rig.loop.counters.reports for rig in rigs} == {len(recording.reports)}


PLACEMENTS = [in_zones(DEVICE, [0]), in_zones(DEVICE, [2], [0]), in_zones(DEVICE, [0, 2]), in_zones(DEVICE, [1])]
CLICKS = made_clicks(DEVICE, [click_of(DEVICE, placement, level_db=26.0) for placement in PLACEMENTS])
SOFT = 10 ** (-6 / 20)
RULES = Effects((Rule(Trigger.TOUCH, click(LEVEL_DB)),))


def waveform_of(event: DriveEvent) -> int | None:
    numbers = [number_of(DEVICE, placement) for placement in PLACEMENTS]
    return None if event.waveform is None else numbers.index(int(event.waveform.samples[1, 0]))


def plays(rig: Rig) -> list[tuple[float, int | None]]:
    """Time in ms from the first touch, and waveform, of each waveform that the firmware began."""
    first_us = rig.start_ns / 1000
    return [
        (int((event.device_time_us - first_us) / 1000), waveform_of(event))
        for event in rig.log
        if event.cause is Cause.PLAY and event.waveform is not None
    ]


def test_a_touch_plays_the_click_of_its_state_at_the_level_of_its_rule() -> None:
    rig = Rig(recording_of(*held(0.0, 0.2, (1, 0.1)), (0.2, report(lifted=[1]))), effects=RULES, clicks=CLICKS).run()
    assert rig.states() == [index_of(0), 0]
    assert [change.is_click for change in rig.trace] == [True, False]
    (event,) = [event for event in rig.log if event.waveform is not None]
    assert event.waveform is not None
    assert abs(event.waveform.amplitude - SOFT) < 1e-4
    assert plays(rig) == [(0, 0)]
    assert event.sequence == rig.trace[0].drive_sequence


def test_a_lift_does_not_cut_a_click() -> None:
    frames = [(0.0, report((1, 0.1))), (0.01, report(lifted=[1])), (0.1, report())]
    rig = Rig(recording_of(*frames), effects=RULES, clicks=CLICKS).run()
    (start,) = [event for event in rig.log if event.waveform is not None]
    later = rig.log[rig.log.index(start) + 1 :]
    assert all(event.device_time_us - start.device_time_us >= 30_000 for event in later)
    assert rig.trace[1].drive_sequence is None


def test_a_click_that_never_left_is_not_played_late() -> None:
    line = VirtualLine()
    frames = [(0.0, report()), *held(0.02, 0.1, (1, 0.1)), *held(0.1, 0.2, (1, 0.3)), (0.2, report(lifted=[1]))]
    rig = Rig(recording_of(*frames), line, effects=RULES, clicks=CLICKS)
    line.stall_at_ns, line.stall_ns = rig.start_ns + 5 * MS, 150 * MS
    rig.run()
    assert [change.is_click for change in rig.trace] == [True, False]
    assert plays(rig) == []


def test_what_is_held_goes_on_after_a_click() -> None:
    held_rule = Rule(Trigger.TOUCH, Effect("held", (Segment(None, LEVEL_DB),)), zones=frozenset({0}))
    effects = Effects((held_rule, Rule(Trigger.TOUCH, click(LEVEL_DB))))
    frames = [*held(0.0, 0.1, (1, 0.1)), *held(0.1, 0.3, (1, 0.1), (2, 0.5)), (0.3, report(lifted=[1, 2]))]
    rig = Rig(recording_of(*frames), effects=effects, clicks=CLICKS).run()
    driven = [
        (event.cause, round(event.channels[0].frequency_hz * bool(event.channels[0].amplitude), 2)) for event in rig.log
    ]
    assert [what for what in driven if what[1]] == [(Cause.SET, 101.0), (Cause.SET, 101.25)]
    assert [waveform for _, waveform in plays(rig)] == [1]


def test_a_device_that_plays_no_clicks_gets_the_steady_drive_for_as_long() -> None:
    configuration = DeviceConfiguration(0x5EED, basis_capacity_bytes=0)
    rig = Rig(
        recording_of(*held(0.0, 0.2, (1, 0.1)), (0.2, report(lifted=[1]))),
        VirtualLine(configuration),
        effects=DEFAULT_EFFECTS,
        clicks=CLICKS,
    ).run()
    assert rig.played() == [101.0, 0.0]
    assert abs(1000 * (rig.log[1].device_time_us - rig.log[0].device_time_us) - 30 * MS) < MS


def test_after_a_reconnect_an_old_click_is_not_played() -> None:
    line = VirtualLine()
    frames = [*held(0.0, 1.0, (1, 0.1)), (1.0, report(lifted=[1]))]
    rig = Rig(recording_of(*frames), line, effects=RULES, clicks=CLICKS, reconnect=True)
    line.stall_at_ns = rig.start_ns + 500 * MS
    rig.run()
    assert rig.loop.counters.reconnects == 1
    assert [waveform for _, waveform in plays(rig)] == [0]


FINGER = MeasuredFinger(0.1 * DEVICE.bar.length_m, 0.7, 0.1)


@dataclass
class OneFinger:
    """Tells one finger at a time, and hears nothing of the board."""

    line: VirtualLine
    at_ns: int
    is_listening = False
    told = False

    def fileno(self) -> int:
        return -2

    def poll(self) -> Sequence[MeasuredFinger] | None:
        if self.told or self.line.time_ns < self.at_ns:
            return None
        self.told = True
        return [FINGER]

    def begin_stream(self) -> None:
        pytest.fail("the board is not listened to")

    def take_event(self, event: Event) -> None:
        pytest.fail(f"the board is not listened to: {event}")


class MeasuringRig(Rig):
    """A finger in zone I for half a second, which is measured after 100 ms."""

    def __init__(self, **more: object) -> None:
        line = VirtualLine(wakes_every_ns=MS)
        told, self.later = OneFinger(line, 0), Later(line)
        recording = recording_of(*held(0.0, 0.5, (1, 0.1)))
        super().__init__(recording, line, measuring=told, updates=self.later, **more)  # type: ignore[arg-type]
        told.at_ns = self.start_ns + 100 * MS


def test_a_steady_drive_is_played_anew_for_the_finger_that_was_measured() -> None:
    rig = MeasuringRig().run()
    assert rig.played()[:2] == [101.0, 101.06]
    began_ms = [(1000 * event.device_time_us - rig.start_ns) / MS for event in rig.log[:2]]
    assert began_ms[1] == pytest.approx(100, abs=5)


def test_a_drive_that_follows_a_click_s_time_is_not_begun_for_it() -> None:
    """Bursts end after 50 ms: where nothing is played any more, a measured finger brings nothing."""
    rig = MeasuringRig(effects=BURSTS).run()
    assert rig.steady.measured == [FINGER] and 101.06 not in rig.played()


def test_a_new_table_knows_the_fingers_that_were_measured() -> None:
    rig = MeasuringRig()
    assert rig.session.link.capabilities is not None
    coming = rendering_of(rig.session.link.capabilities, HELD, rig.clicks, always_hz=None)
    rig.later.coming = [(rig.start_ns + 200 * MS, coming)]
    rig.run()
    assert coming.renderer.steady.measured == [FINGER]  # type: ignore[attr-defined]


def run_with_ring(
    path: Path, *frames: tuple[float, bytes], effects: Effects = HELD, bit_rate_hz: int = BIT_RATE_HZ
) -> tuple[Rig, list[Record]]:
    with RingWriter(path) as writer, RingReader(path) as reader:
        rig = Rig(recording_of(*frames), effects=effects, bit_rate_hz=bit_rate_hz, ring=writer).run()
        return rig, list(reader.read())


def test_the_ring_has_every_report_and_command_with_its_fingers_its_sequence_and_its_stamps(tmp_path: Path) -> None:
    frames = [*held(0.0, 0.1, (1, 0.1)), *held(0.1, 0.2, (1, 0.1), (2, 0.5)), (0.2, report(lifted=[1, 2]))]
    rig, records = run_with_ring(tmp_path / "ring", *frames)
    told = [(record.report_index, record.report) for record in records if record.report]
    assert told == [(r.index, r.data) for r in rig.recording.reports]
    assert all(later.time_ns >= earlier.time_ns for earlier, later in pairwise(records))
    sent = [record for record in records if record.drive_sequence is not None]
    changes = [change for change in rig.trace if change.drive_sequence is not None]
    assert [(r.report_index, r.placement, r.drive_sequence, r.touches) for r in sent] == [
        (c.report_index, c.placement, c.drive_sequence, tuple(c.touches)) for c in changes
    ]
    assert [touch.zone for touch in sent[1].touches] == [0, 2]
    assert [list(record.stamps_ns) for record in sent] == rig.latency.rows_ns().tolist()
    assert sent[-1].counters.commands == rig.loop.counters.commands


def test_what_time_alone_brings_is_told_too(tmp_path: Path) -> None:
    frames = [(0.0, report((1, 0.1))), (0.1, report(lifted=[1]))]
    rig, records = run_with_ring(tmp_path / "ring", *frames, effects=BURSTS)
    (ended,) = [record for record in records if record.report_index is None]
    assert (ended.placement, ended.level_db) == (rig.trace[1].placement, None)
    assert ended.drive == b""


def test_a_command_that_the_line_held_up_is_told_when_it_has_left(tmp_path: Path) -> None:
    places = [0.1, 0.3, 0.5, 0.7, 0.9]
    frames = [(0.0005 * i, report((1, place))) for i, place in enumerate(places)]
    rig, records = run_with_ring(tmp_path / "ring", *frames, *held(0.008, 0.1, (1, 0.9)), bit_rate_hz=115_200)
    told = [record.drive_sequence for record in records if record.drive_sequence is not None]
    assert told == [change.drive_sequence for change in rig.trace if change.drive_sequence is not None]
    assert records[-1].counters.replaced > 0
