"""Laws of clicks that no table holds: asked for once, played once when they come, and remembered."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import pytest

from engine.device import Device
from engine.effects.rules import Effect, Effects, Rule, Segment, Trigger, click
from engine.loop.beside import AwaitedClicks
from engine.loop.observer import LoopCounters
from engine.loop.pipeline import LATEST_NS
from engine.table import ClickEntry, Clicks
from engine.touch import Placement
from firmware_link.emulator.drive_log import Cause
from tests.engine.loop.rig import DEVICE, Rig, held, recording_of, rendering_of, report
from tests.engine.loop.test_table_swap import Later
from tests.engine.made_table import LEVEL_DB, click_of, in_zones, made_clicks, number_of
from tests.tools.virtual import MS, VirtualLine

RUNS_BOTH_WAYS = True
RULES = Effects((Rule(Trigger.TOUCH, click(LEVEL_DB)),))
# The table has clicks of one finger only. One rests in the middle of zone I from the start, another taps in zone V.
CLICKS = [click_of(DEVICE, in_zones(DEVICE, [zone])) for zone in range(5)]
TABLE = made_clicks(DEVICE, CLICKS)
LARGER_TABLE = made_clicks(DEVICE, [*CLICKS, click_of(DEVICE, in_zones(DEVICE, [4], [0]))])
MOVED_M = 5e-3
# Its fingers are the same, and its bar lies elsewhere under the digitizer.
OTHER_DEVICE = replace(
    Device.parse(DEVICE.text.replace("count = 5", "count = 4"), "bar.toml"),
    touch_axis=replace(DEVICE.touch_axis, start_margin_m=MOVED_M, end_margin_m=-MOVED_M),
)
RESTING = [(1, 0.1)]
TAP = [*RESTING, (2, 0.9)]
TAP_NS = 200 * MS


@dataclass
class Solving:
    """Solves each click `takes_ms` after it was asked for, until it ends at `end_ns`."""

    line: VirtualLine
    takes_ms: float
    fingerprint: str | None = None
    end_ns: float = math.inf
    asked: list[tuple[int, Placement, Device]] = field(default_factory=list)
    answered: int = 0

    @property
    def is_there(self) -> bool:
        return self.line.time_ns < self.end_ns

    def fileno(self) -> int:
        return -2

    def ask_for_click(self, placement: Placement, device: Device) -> None:
        self.asked.append((self.line.time_ns, placement, device))

    def poll(self) -> Sequence[tuple[str, ClickEntry]]:
        latest_ns = self.line.time_ns - self.takes_ms * MS
        ready = [(at, device) for at_ns, at, device in self.asked if at_ns <= latest_ns] if self.is_there else []
        found, self.answered = ready[self.answered :], max(self.answered, len(ready))
        return [(self.fingerprint or device.fingerprint, click_of(DEVICE, at)) for at, device in found]


def taps(count: int = 1) -> list[tuple[float, bytes]]:
    """A finger comes, and from 200 ms on another one taps each 200 ms, for 100 ms."""
    frames = held(0.0, 0.2, *RESTING)
    for tap in range(count):
        start_s = 0.2 * (tap + 1)
        frames += [*held(start_s, start_s + 0.1, *TAP), (start_s + 0.1, report(*RESTING, lifted=[2]))]
        frames += held(start_s + 0.104, start_s + 0.2, *RESTING)
    return frames


class SolvingRig(Rig):
    """A run beside which clicks are solved, and to which other tables come."""

    def __init__(
        self,
        frames: Sequence[tuple[float, bytes]],
        takes_ms: float,
        fingerprint: str | None = None,
        effects: Effects = RULES,
    ) -> None:
        line = VirtualLine(wakes_every_ns=MS)
        self.solver, self.later = Solving(line, takes_ms, fingerprint), Later(line)
        recording = recording_of(*frames)
        super().__init__(recording, line, effects=effects, clicks=TABLE, solving=self.solver, updates=self.later)
        self.tap_ns = self.start_ns + TAP_NS

    def swap(self, after_ms: float, device: Device = DEVICE, clicks: Clicks = TABLE) -> None:
        """Another table comes so long after the tap."""
        capabilities = self.session.link.capabilities
        assert capabilities is not None
        coming = rendering_of(capabilities, RULES, clicks, device, always_hz=150.0)
        self.later.coming = [(self.tap_ns + round(after_ms * MS), coming)]


def answers(rig: Rig, tap: int = 0) -> list[tuple[float, str | int]]:
    """What the device began within 0.2 s of a tap: ms after it, and the number of a click or "drive"."""
    tap_us = (rig.start_ns + (tap + 1) * TAP_NS) / 1000
    return [
        ((event.device_time_us - tap_us) / 1000, int(event.waveform.samples[1, 0]) if event.waveform else "drive")
        for event in rig.log
        if 0 <= event.device_time_us - tap_us < 190_000
        and (event.waveform is not None or (event.cause is Cause.SET and event.channels[0].amplitude))
    ]


def number(felt: int, quiet: int) -> int:
    return number_of(DEVICE, in_zones(DEVICE, [felt], [quiet]))


@pytest.mark.parametrize("takes_ms", [0, 12, 28])
def test_an_awaited_click_is_solved_where_its_fingers_are_and_played_once_when_it_comes(takes_ms: float) -> None:
    rig = SolvingRig(taps(), takes_ms)
    rig.run()
    ((_, asked, _),) = rig.solver.asked
    assert asked in [change.placement for change in rig.trace]
    assert asked != in_zones(DEVICE, [4], [0]) and asked.is_felt == (False, True)
    ((after_ms, what),) = answers(rig)
    assert what == number(4, 0) and takes_ms <= after_ms <= takes_ms + 3
    assert rig.steady.solved == [] and rig.loop.counters.learned == 1


LATEST_MS = LATEST_NS / MS


@pytest.mark.parametrize(("takes_ms", "is_played"), [(60, True), (LATEST_MS - 4, True), (LATEST_MS + 4, False)])
def test_a_click_is_played_beyond_its_own_end_but_not_after_its_latest_time(takes_ms: float, is_played: bool) -> None:
    rig = SolvingRig(taps(2), takes_ms)
    rig.run()
    first = answers(rig, tap=0)
    assert [what for _, what in first] == [number(4, 0)] * is_played
    assert all(takes_ms <= after_ms < takes_ms + 3 for after_ms, _ in first)
    ((after_ms, what),) = answers(rig, tap=1)  # the same fingers again: it is known by now
    assert what == number(4, 0) and after_ms < 3 and len(rig.solver.asked) == 1


@pytest.mark.parametrize("end_ns", [math.inf, -math.inf])
def test_whether_a_solver_is_there_is_known_before_the_first_touch(end_ns: float) -> None:
    pipeline = SolvingRig(taps(), 20).loop._pipeline
    AwaitedClicks(Solving(VirtualLine(), 20, end_ns=end_ns), pipeline, LoopCounters(), lambda _: None)
    assert pipeline.answerer.awaits_clicks == (end_ns > 0)


def test_where_the_solver_ends_the_steady_drive_answers_the_touch_that_waits_and_each_later_one() -> None:
    rig = SolvingRig(taps(2), 20)
    rig.solver.end_ns = rig.tap_ns + 10 * MS
    rig.run()
    for tap, end_ms in enumerate((10, 0)):
        ((after_ms, what),) = answers(rig, tap)
        assert what == "drive" and end_ms <= after_ms < end_ms + 3
    assert len(rig.solver.asked) == 1
    answered = [change.report_index for change in rig.trace if change.placement is not None and change.drive]
    assert [index is None for index in answered] == [True, False]  # the later one by the report itself


def test_a_click_of_another_device_is_dropped() -> None:
    rig = SolvingRig(taps(), 5, fingerprint="that of an earlier table")
    rig.run()
    assert answers(rig) == [] and rig.loop.counters.learned == 0


def test_a_lift_ends_the_wait() -> None:
    frames = [*held(0.0, 0.2, *RESTING), (0.2, report(*TAP)), (0.21, report(*RESTING, lifted=[2]))]
    rig = SolvingRig([*frames, *held(0.22, 0.3, *RESTING)], 18)
    rig.run()
    assert answers(rig) == [] and rig.loop.counters.learned == 1
    assert all(change.report_index is not None for change in rig.trace if change.time_ns >= rig.tap_ns)


def test_what_follows_the_click_ends_the_wait() -> None:
    envelope = (Segment(None, LEVEL_DB, is_click=True), Segment(None, LEVEL_DB))
    held_after = Effects((Rule(Trigger.TOUCH, Effect("click, then held", envelope), zones=frozenset({4})),))
    rig = SolvingRig(taps(), 60, effects=held_after)
    rig.swap(45, OTHER_DEVICE)
    rig.run()
    (first_ms, first), (second_ms, second) = answers(rig)
    assert first == second == "drive" and 30 <= first_ms <= 33 and 45 <= second_ms <= 48


def test_a_later_touch_is_awaited_in_place_of_the_first() -> None:
    frames = [*held(0.0, 0.2, *RESTING), (0.2, report(*TAP)), (0.205, report((2, 0.9), lifted=[1]))]
    rig = SolvingRig([*frames, *held(0.21, 0.4, (2, 0.9), (3, 0.5)), (0.4, report(lifted=[2, 3]))], 18)
    rig.run()
    ((after_ms, what),) = answers(rig)
    assert what == number(2, 4) and 28 <= after_ms <= 31 and rig.loop.counters.learned == 2


@pytest.mark.parametrize("clicks", [TABLE, LARGER_TABLE])
def test_a_click_is_played_once_from_a_table_of_the_same_device_that_comes_meanwhile(clicks: Clicks) -> None:
    rig = SolvingRig(taps(), 12)
    rig.swap(5, clicks=clicks)
    rig.run()
    ((after_ms, what),) = answers(rig)
    assert what == number(4, 0) and 5 <= after_ms <= 15
    assert (rig.loop.counters.swaps, len(rig.solver.asked)) == (1, 1)


def test_a_table_of_another_device_that_comes_meanwhile_has_the_click_solved_where_its_fingers_are() -> None:
    rig = SolvingRig(taps(), 12)
    rig.swap(5, OTHER_DEVICE)
    rig.run()
    ((after_ms, what),) = answers(rig)
    assert what == number(4, 0) and 17 <= after_ms <= 21
    (_, before, _), (_, after, device) = rig.solver.asked
    assert device is OTHER_DEVICE and rig.loop.counters.learned == 1
    assert after.position_m == pytest.approx([at_m + MOVED_M for at_m in before.position_m])


def test_a_click_that_would_have_ended_is_awaited_no_more_after_a_change_of_table() -> None:
    rig = SolvingRig(taps(), 60)
    rig.swap(45)
    rig.run()
    assert answers(rig) == [] and len(rig.solver.asked) == 1
