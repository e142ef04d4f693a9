"""Laws of control steps in the loop: taken between two frames, told once their command is written, no report lost."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass, field

import pytest

from engine.effects import ControlStep, Effects, Outcome, Rule, Trigger, TriggeredEffect
from engine.effects.rules import click
from engine.loop import Fate
from tests.engine.loop.rig import DEVICE, Rig, held, recording_of, report
from tests.engine.loop.test_pipeline import pipeline_of
from tests.engine.made_clicks import every_click
from tests.quick import first_quick
from tests.tools.virtual import MS, VirtualLine

RUNS_BOTH_WAYS = True
CLICKS = every_click(DEVICE)
SOFT, FIRM, STRONG = (click(level_db) for level_db in (10.0, 15.0, 20.0))
OTHER = click(12.34)


def rules_of(*effects: object, others: bool = True) -> Effects:
    """A rule on touch for each zone that has an effect; what is prepared covers three of the levels."""
    rules = [Rule(Trigger.TOUCH, effect, frozenset({zone})) for zone, effect in enumerate(effects) if effect]  # type: ignore[arg-type]
    return Effects(tuple(rules), (SOFT, FIRM, STRONG) if others else ())


@dataclass
class Slot:
    """Gives each step at its time, ms after the start, one after another."""

    steps: Sequence[tuple[float, ControlStep]]
    line: VirtualLine
    told: list[tuple[int, Outcome]] = field(default_factory=list)

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
        return step

    def tell(self, outcome: Outcome) -> None:
        self.told.append((self.line.time_ns - self.start_ns, outcome))


def run(
    frames: Sequence[tuple[float, bytes]], steps: Sequence[tuple[float, ControlStep]], effects: Effects
) -> tuple[Rig, Slot]:
    line = VirtualLine(wakes_every_ns=MS)
    slot = Slot(steps, line)
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


def test_a_trigger_without_a_finger_plays_nothing() -> None:
    step = ControlStep(trigger=TriggeredEffect(STRONG, 1, contact_id=5))
    rig, slot = run([*held(0.0, 0.3, (1, 0.1)), (0.3, report(lifted=[1]))], [(100.0, step)], rules_of(None))
    assert slot.told[0][1] is Outcome.NO_FINGER and clicks_of(rig) == []


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
    asked = [(time_ms, ControlStep(effects=rules)) for time_ms, rules in steps]
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


def test_the_same_steps_at_the_same_times_give_the_same_commands() -> None:
    random_ = random.Random(6)
    rig = Rig(recording_of(*taps(60)), effects=rules_of(SOFT, FIRM, STRONG), clicks=CLICKS)
    steps = [
        ControlStep(
            effects=random_.choice((None, rules_of(*random_.choices((None, SOFT, FIRM), k=5)))),
            ended_owner=random_.choice((None, 1, 2)),
            roles=random_.choice(((), ((1, True),), ((1, False),))),
            trigger=random_.choice(
                (
                    None,
                    TriggeredEffect(STRONG, 1, contact_id=1),
                    TriggeredEffect(FIRM, 2, position_m=random_.random() / 4),
                )
            ),
        )
        for _ in rig.recording.reports
    ]
    found = []
    for _ in range(2):
        pipeline, commands = pipeline_of(rig), []
        for entry, step in zip(rig.recording.reports, steps, strict=True):
            time_ns = round(1e9 * entry.time_s)
            commands += [*pipeline.advance(time_ns), pipeline.step(entry.data, time_ns)]
            commands += [*pipeline.advance(time_ns + MS), pipeline.control(step, time_ns + MS)[1]]
        found.append(commands)
    assert found[0] == found[1]
    assert len([command for command in found[0] if command is not None]) > 50
