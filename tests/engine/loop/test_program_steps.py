"""Laws of control steps in the loop: taken between two frames, told once their command is written, no report lost."""

import random
from collections.abc import Sequence
from dataclasses import dataclass, field

import pytest

from engine.effects.rules import (
    ControlStep,
    Effects,
    Outcome,
    Rule,
    SceneSettings,
    Trigger,
    TriggeredEffect,
    burst,
    click,
)
from engine.loop.observer import Fate
from firmware_link.emulator.drive_log import Cause
from tests.engine.loop.rig import DEVICE, Rig, held, recording_of, report
from tests.engine.made_table import every_click
from tests.quick import first_quick
from tests.tools.virtual import MS, VirtualLine

RUNS_BOTH_WAYS = True
CLICKS = every_click(DEVICE)
SOFT, FIRM, STRONG = (click(level_db) for level_db in (10.0, 15.0, 20.0))
OTHER = click(12.34)
NOTHING = ControlStep()
ALONE = SceneSettings(uses_rule_file=False)


def rules_of(*effects: object) -> Effects:
    """A rule on touch for each zone that has an effect; what is prepared covers three of the levels."""
    rules = [Rule(Trigger.TOUCH, effect, frozenset({zone})) for zone, effect in enumerate(effects) if effect]  # type: ignore[arg-type]
    return Effects(tuple(rules), (SOFT, FIRM, STRONG))


@dataclass
class Slot:
    """Gives each step at its time, ms after the start, one after another."""

    steps: Sequence[tuple[float, ControlStep]]
    line: VirtualLine
    told: list[tuple[int, Outcome]] = field(default_factory=list)
    begins_with: ControlStep = NOTHING
    stall_ns: int = 0
    """How long the loop stands still when it looks for a step that is there."""

    def scene(self) -> ControlStep:
        return self.begins_with

    def __post_init__(self) -> None:
        self.start_ns = 0
        self._given = 0

    def fileno(self) -> int:
        return -3

    def poll(self) -> ControlStep | None:
        if self._given == len(self.steps) or self._given > len(self.told):
            return None
        time_ms, step = self.steps[self._given]
        if self.line.time_ns < self.start_ns + time_ms * MS:
            return None
        self._given += 1
        self.line.clock.run_to(self.line.time_ns + self.stall_ns)
        return step

    def tell_outcome(self, outcome: Outcome) -> None:
        self.told.append((self.line.time_ns - self.start_ns, outcome))


def run(
    frames: Sequence[tuple[float, bytes]],
    steps: Sequence[tuple[float, ControlStep]],
    effects: Effects,
    begins_with: ControlStep = NOTHING,
    stall_ns: int = 0,
) -> tuple[Rig, Slot]:
    line = VirtualLine(wakes_every_ns=MS)
    slot = Slot(steps, line, begins_with=begins_with, stall_ns=stall_ns)
    rig = Rig(recording_of(*frames), line, effects=effects, clicks=CLICKS, control=slot)
    slot.start_ns = rig.start_ns
    rig.run()
    assert len(slot.told) == len(steps)
    return rig, slot


def taps(count: int, every_s: float = 0.04, zone: int | None = None) -> list[tuple[float, bytes]]:
    """Short touches of the middles of zones, in turn or of one."""
    frames = []
    for tap in range(count):
        place = (0.1 + 0.2 * (tap % 5)) if zone is None else 0.1 + 0.2 * zone
        frames += [*held(every_s * tap, every_s * tap + 0.016, (1, place)), (every_s * tap + 0.016, report(lifted=[1]))]
    return frames


def clicks_of(rig: Rig) -> list[tuple[float, float | None]]:
    """Time after the start in ms, and level, of each click that was wanted."""
    return [((each.time_ns - rig.start_ns) / MS, each.level_db) for each in rig.trace if each.is_click]


def test_a_program_triggers_a_click_at_a_resting_finger_and_hears_of_it_once_it_is_written() -> None:
    step = ControlStep(trigger=TriggeredEffect(STRONG, 1, contact_id=1))
    rig, slot = run([*held(0.0, 0.3, (1, 0.1)), (0.3, report(lifted=[1]))], [(100.0, step)], rules_of(None))
    ((time_ms, level_db),) = clicks_of(rig)
    assert 100 <= time_ms <= 102 and level_db == 20.0
    ((told_ns, outcome),) = slot.told
    (written,) = [each for each in rig.trace if each.is_click]
    assert outcome is Outcome.DONE and written.fate is Fate.WRITTEN
    assert told_ns >= written.stamps_ns[-1] - rig.start_ns
    assert rig.loop.counters.controlled == 1
    assert len([event for event in rig.log if event.waveform is not None]) == 1


@pytest.mark.parametrize("levels", first_quick(["any", "prepared"]))
def test_while_a_scene_changes_a_thousand_times_each_touch_feels_the_rules_of_its_moment(levels: str, way: str) -> None:
    random_ = random.Random(5)
    count = 250
    effects = (None, SOFT, FIRM, STRONG, *([OTHER] if levels == "any" else []))
    steps, now = [(0.0, rules_of(*random_.choices(effects, k=5)))], 1.0
    while len(steps) < 1000:
        # Between two frames of 8 ms, so that it is certain which one is first.
        steps.append((8 * int(now / 8) + random_.choice((3.0, 5.0)), rules_of(*random_.choices(effects, k=5))))
        now += (40 * count - 60) / 1000
    asked = [(time_ms, ControlStep(rules.rules, ALONE)) for time_ms, rules in steps]
    rig, slot = run(taps(count), asked, steps[0][1])
    assert rig.loop.counters.reports == len(rig.recording.reports)
    assert [outcome for _, outcome in slot.told] == [Outcome.DONE] * 1000
    expected = list[tuple[int, float | None]]()
    for tap in range(count):
        rules = [rules for told, (_, rules) in zip(slot.told, steps, strict=True) if told[0] < 40 * tap * MS][-1:]
        for rule in (rules or [steps[0][1]])[0].rules:
            if rule.zones == frozenset({tap % 5}):
                expected.append((40 * tap, rule.effect.envelope[0].level_db))
    assert [(round(time_ms), level_db) for time_ms, level_db in clicks_of(rig)] == expected
    assert len([event for event in rig.log if event.waveform is not None]) == len(expected)
    if way == "fast path" and levels == "prepared":
        assert rig.session.fast_counters.answered > len(expected) / 2


def test_a_run_begins_with_what_programs_want_already() -> None:
    off = ControlStep((), SceneSettings(is_enabled=False))
    rig, _ = run(taps(10, zone=0), [(180.0, ControlStep(settings=SceneSettings()))], rules_of(STRONG), off)
    assert [round(time_ms) for time_ms, _ in clicks_of(rig)] == [200, 240, 280, 320, 360]


def test_feeling_that_is_switched_off_silences_a_click_that_sounds() -> None:
    steps = [(3.0, ControlStep(settings=SceneSettings(is_enabled=False)))]
    rig, _ = run([*held(0.0, 0.3, (1, 0.1)), (0.3, report(lifted=[1]))], steps, rules_of(STRONG))
    click_us, silent_us = [event.device_time_us for event in rig.log if event.cause in (Cause.PLAY, Cause.SET)][:2]
    assert silent_us - click_us < 10_000 and clicks_of(rig)[0][1] == 20.0
    assert not any(channel.amplitude for channel in rig.log[-1].channels)


@pytest.mark.parametrize("change_db", [-6.0, 0.0])
def test_each_tap_has_the_level_of_the_scene_whichever_step_answers(change_db: float, way: str) -> None:
    settings = SceneSettings(level_change_db=change_db)
    rig, _ = run(taps(10, zone=0), [(100.0, ControlStep(settings=settings))], rules_of(STRONG))
    expected = [20.0] * 3 + [20.0 + change_db] * 7
    assert [level_db for _, level_db in clicks_of(rig)] == expected
    if way == "fast path":
        assert (rig.session.fast_counters.answered > 5) is (change_db == 0.0)


def test_what_is_due_before_a_step_is_taken_before_it() -> None:
    """The pass stands still between its reports and its step: what has ended by then is not felt beside it."""
    trigger = TriggeredEffect(burst(10.0, 20), 1, contact_id=2)
    frames = [*held(0.0, 0.3, (1, 0.1), (2, 0.9)), (0.3, report(lifted=[1, 2]))]
    rig, _ = run(frames, [(15.0, ControlStep(trigger=trigger))], rules_of(burst(20.0, 20)), stall_ns=30 * MS)
    felt = [each.placement.is_felt for each in rig.trace if each.fate is not Fate.NONE and each.placement]
    assert felt == [(True, False), (False, True)]


def test_a_finger_that_is_not_there_and_a_place_beyond_the_bar_that_is_played_now_are_refused() -> None:
    """As after a change to the table of a shorter bar, which a program has not heard of yet."""
    length_m = DEVICE.bar.length_m
    asked = [TriggeredEffect(STRONG, 1, contact_id=5)]
    asked += [TriggeredEffect(STRONG, 1, position_m=at_m) for at_m in (length_m + 1e-6, length_m)]
    steps = [(10.0 + 50 * number, ControlStep(trigger=trigger)) for number, trigger in enumerate(asked)]
    rig, slot = run([*held(0.0, 0.3, (1, 0.1)), (0.3, report(lifted=[1]))], steps, rules_of(None))
    assert [outcome for _, outcome in slot.told] == [Outcome.NO_FINGER, Outcome.OFF_BAR, Outcome.DONE]
    assert len(clicks_of(rig)) == 1
