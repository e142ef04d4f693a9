"""Changing over to another table while fingers are on the bar, in virtual time."""

from dataclasses import dataclass, field, replace
from math import inf

import numpy as np
import pytest

from engine.effects.rules import Effects, Rule, Trigger, click
from engine.render.prepared import Rendering
from engine.table import Clicks
from engine.touch.sources.recording import Recording
from firmware_link.emulator.device_state import DeviceConfiguration
from firmware_link.emulator.drive_log import Cause, Outcome
from tests.engine.loop.rig import DEVICE, HELD, NO_CLICKS, Rig, held, recording_of, rendering_of, report
from tests.engine.made_table import LEVEL_DB, click_of, in_zones, made_clicks
from tests.tools.virtual import MS, VirtualLine

CLICKS = Effects((Rule(Trigger.TOUCH, click(LEVEL_DB)),))


def clicks_of(number: int, longer: int = 0) -> Clicks:
    """Clicks of single fingers in zones, told apart by their samples; `longer` ones are of another basis."""
    made = [click_of(DEVICE, in_zones(DEVICE, [zone]), level_db=26.0, count=121 + longer) for zone in range(5)]
    return made_clicks(DEVICE, [replace(each, weights=np.full(2, number, np.int16)) for each in made])


@dataclass
class Later:
    """Tables that come at their times."""

    line: VirtualLine
    coming: list[tuple[int, Rendering]] = field(default_factory=list)

    def fileno(self) -> int:
        return -2

    def poll(self) -> Rendering | None:
        if self.coming and self.coming[0][0] <= self.line.time_ns:
            return self.coming.pop(0)[1]
        return None


class SwapRig(Rig):
    """A run to which other tables come."""

    def __init__(
        self, recording: Recording, effects: Effects = HELD, clicks: Clicks = NO_CLICKS, capacity_bytes: int = 1 << 18
    ) -> None:
        line = VirtualLine(DeviceConfiguration(0, basis_capacity_bytes=capacity_bytes))
        self.later = Later(line)
        super().__init__(recording, line, effects=effects, clicks=clicks, updates=self.later)
        assert self.session.link.capabilities is not None
        self.capabilities = self.session.link.capabilities

    def table(self, frequency_hz: float, clicks: Clicks = NO_CLICKS) -> Rendering:
        return rendering_of(self.capabilities, self.effects, clicks, always_hz=frequency_hz)

    def run_over(self, *coming: tuple[float, Rendering]) -> None:
        """Tables come so many ms after the first report."""
        self.later.coming = [(self.start_ns + round(after_ms * MS), rendering) for after_ms, rendering in coming]
        self.run()

    def played_samples(self) -> list[int]:
        found = [event.waveform for event in self.log if event.waveform is not None]
        return [int(each.samples[1, 0]) for each in found]

    def transfers(self) -> int:
        """How many bases the device has taken."""
        return sum(
            frame.message == "BASIS_COMMIT" and frame.outcome is Outcome.ACCEPTED
            for frame in self.line.firmware.received
        )


def test_a_resting_finger_feels_the_new_table_from_the_next_frame_on() -> None:
    rig = SwapRig(recording_of(*held(0.0, 0.4, (1, 0.1)), (0.4, report(lifted=[1]))))
    rig.run_over((200.0, rig.table(150.0)))
    assert rig.played() == [101.0, 150.0, 0.0]
    first, second, _ = (event.device_time_us for event in rig.log)
    assert 198_000 <= second - first <= 210_000
    assert rig.loop.counters.swaps == 1
    assert all(event.cause is Cause.SET for event in rig.log)


def taps(count: int) -> Recording:
    frames = list[tuple[float, bytes]]()
    for tap in range(count):
        start_s, contact = 0.1 * tap, tap % 15
        frames += [*held(start_s, start_s + 0.05, (contact, 0.1)), (start_s + 0.05, report(lifted=[contact]))]
    return recording_of(*frames)


@pytest.mark.parametrize(("capacity_bytes", "most_missed"), [(1 << 18, 0), (600, 2)])
def test_clicks_play_on_until_the_next_basis_is_there_or_no_finger_is(capacity_bytes: int, most_missed: int) -> None:
    """Without room a tap may fall into the new session."""
    rig = SwapRig(taps(20), CLICKS, clicks_of(1), capacity_bytes)
    rig.run_over((320.0, rig.table(100.0, clicks_of(2, longer=4))))
    played = rig.played_samples()
    assert played == sorted(played) and len(played) >= 20 - most_missed
    assert played.count(1) >= 4 and played.count(2) >= 10
    assert (rig.transfers(), rig.loop.counters.swaps, rig.loop.counters.reconnects) == (2, 1, 0)


def test_other_clicks_of_the_same_basis_need_no_transfer() -> None:
    rig = SwapRig(taps(6), CLICKS, clicks_of(1))
    rig.run_over((120.0, rig.table(100.0, clicks_of(2))))
    assert rig.loop.counters.swaps == 1
    assert rig.transfers() == 1
    assert rig.played_samples() == [1, 1, 2, 2, 2, 2]


def test_other_limits_begin_a_new_session_when_nobody_touches() -> None:
    rig = SwapRig(taps(6))
    softer = rig.table(150.0)
    rig.run_over((120.0, replace(softer, configuration=replace(softer.configuration, amplitude_limits=(0.5, 0.5)))))
    log = rig.log
    assert {round(event.channels[0].amplitude, 2) for event in log} == {0.0, 0.5, 1.0}
    assert 150.0 in rig.played()


def test_a_newer_table_takes_the_place_of_one_that_is_under_way() -> None:
    rig = SwapRig(taps(20), CLICKS, clicks_of(1))
    rig.run_over((320.0, rig.table(100.0, clicks_of(2, 4))), (323.0, rig.table(100.0, clicks_of(3, 8))))
    played = rig.played_samples()
    assert played[-1] == 3
    assert played == sorted(played)


def test_a_table_for_another_wire_is_left() -> None:
    rig = SwapRig(taps(4))
    foreign = replace(rig.capabilities, frequency_resolution_hz=0.02)
    rig.run_over((120.0, rendering_of(foreign, HELD, always_hz=150.0)))
    assert rig.loop.counters.swaps == 0
    assert set(rig.played()) == {101.0, 0.0}


def test_1000_changes_lose_no_report_and_no_command() -> None:
    count = 1000
    rig = SwapRig(taps(40))
    tables = [rig.table(100.0 + i % 7) for i in range(7)]
    rig.run_over(*((3.9 * i, tables[i % 7]) for i in range(count)))
    assert rig.loop.counters.swaps == count
    assert rig.loop.counters.reports == len(rig.recording.reports)
    touched = [change for change in rig.trace if change.report_index is not None]
    assert len(touched) == 80
    due_ns = [rig.start_ns + round(1e9 * rig.recording.reports[change.report_index or 0].time_s) for change in touched]
    late_ns = [change.time_ns - due for change, due in zip(touched, due_ns, strict=True)]
    assert max(late_ns) == 0
    assert all(change.level_db in (LEVEL_DB, None, inf) for change in rig.trace)
