"""Laws of a change to the table of another bar while fingers lie on the one before: longer, shorter, of other zones."""

import ctypes
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from engine.device import Device, TouchAxis, Zone
from engine.effects.rules import (
    ControlStep,
    Effect,
    Effects,
    Outcome,
    Role,
    Rule,
    Segment,
    Trigger,
    TriggeredEffect,
    burst,
    click,
)
from engine.loop.pipeline import Pipeline, open_pipeline
from engine.render.prepared import Rendering
from engine.render.renderer import SILENCE
from engine.touch.digitizer import RELEASE_AFTER_NS
from engine.touch.finger_tracker import REACH_M
from engine.touch.placement import CLOSEST_M
from engine.touch.sources.recording import Recording
from tests.engine.loop.fast.scripts import random_frames, random_rules, varied_clicks
from tests.engine.loop.rig import DEVICE, HELD, Rig, held, recording_of, rendering_of, report
from tests.engine.loop.test_table_swap import Later
from tests.engine.made_table import LEVEL_DB
from tests.quick import first_quick
from tests.tools.virtual import MS, VirtualLine

LENGTH_M = DEVICE.bar.length_m
EVERYTHING = Effects(
    (
        Rule(Trigger.TOUCH, click(LEVEL_DB), zones=frozenset({3, 4})),
        Rule(Trigger.TOUCH, Effect("held", (Segment(None, LEVEL_DB),))),
        Rule(Trigger.DRAG, burst(LEVEL_DB, 20), region_m=(0.5 * LENGTH_M, LENGTH_M), every_m=5e-3),
        Rule(Trigger.HOLD, Effect("purr", (Segment(None, LEVEL_DB),)), after_ns=50 * MS),
        Rule(Trigger.LIFT, burst(LEVEL_DB, 300)),
    )
)


def bar(length: float = 1.0, zones: int = 5, *, flip: bool = False) -> Device:
    """A bar from the start of the same digitizer, which is as long as the published bar; `length` is its share."""
    length_m, share = length * LENGTH_M, (1 - length) * LENGTH_M
    edges_m = np.linspace(0.0, length_m, zones + 1).tolist()
    made = tuple(Zone(str(i), *edges_m[i : i + 2]) for i in range(zones))
    axis = TouchAxis("x", flip, -share if flip else 0.0, 0.0 if flip else -share, LENGTH_M)
    return replace(DEVICE, surface=replace(DEVICE.bar, length_m=length_m), zones=made, touch_axis=axis)


def rendering_for(rig: Rig, device: Device, *, has_clicks: bool = False) -> Rendering:
    assert rig.session.link.capabilities is not None
    clicks = varied_clicks(device, missing=10**6) if has_clicks else rig.clicks
    return rendering_of(rig.session.link.capabilities, rig.effects, clicks, device)


RIG = Rig(recording_of((0.0, report((1, 0.1)))), effects=EVERYTHING, device=bar())
lengths = st.sampled_from([0.3, 0.5, 0.9, 1.0])
Step = tuple[str, object]
steps = st.one_of(
    st.tuples(st.just("fingers"), st.dictionaries(st.integers(1, 2), st.floats(0, 1), max_size=2)),
    st.tuples(st.just("bar"), st.builds(bar, lengths, st.integers(1, 5))),
    st.tuples(st.just("bar"), st.builds(bar, lengths, st.just(5), flip=st.booleans())),
    st.tuples(st.just("place"), st.floats(0, 1)),
    st.tuples(st.just("quiet"), st.integers(1, 2)),
)


@dataclass
class Story:
    """A pipeline, the fingers at their places (fractions of the digitizer), and the time."""

    pipeline: Pipeline
    time_ns: int = 0
    reported_ns: int = 0
    places: dict[int, float] = field(default_factory=dict)

    def take(self, kind: str, value: object) -> None:
        self.time_ns += 15 * MS
        for _ in self.pipeline.commands_due(self.time_ns):
            self.look()
        if self.time_ns - self.reported_ns >= RELEASE_AFTER_NS:  # a digitizer that is silent has lost its fingers
            self.places = {}
        if kind == "fingers":
            assert isinstance(value, dict)
            gone = [contact for contact in self.places if contact not in value]
            self.places, self.reported_ns = value, self.time_ns
            self.pipeline.step(report(*value.items(), lifted=gone[: 2 - len(value)]), self.time_ns)
        elif kind == "bar":
            assert isinstance(value, Device)
            self.change_bar(value)
        elif kind == "place":
            assert isinstance(value, float)
            self.trigger(value * LENGTH_M)
        else:
            self.pipeline.control(ControlStep(role=Role(value, True, 1)), self.time_ns)  # type: ignore[arg-type]  # an int
        self.look()

    def change_bar(self, device: Device) -> None:
        before = {contact: finger.play for contact, finger in self.pipeline.player.fingers.items()}
        self.pipeline.change_table(rendering_for(RIG, device))
        self.pipeline.command()
        fingers = self.pipeline.player.fingers
        assert set(fingers) == {contact for contact in self.places if self.is_on_bar(contact)}
        assert all(finger.play is before.get(contact) for contact, finger in fingers.items())

    def is_on_bar(self, contact: int) -> bool:
        axis, length_m = self.pipeline.device.touch_axis, self.pipeline.device.bar.length_m
        place = round(1000 * self.places[contact]) / 1000
        at_m = axis.start_margin_m + (1 - place if axis.flip else place) * LENGTH_M
        return -REACH_M <= at_m <= length_m + REACH_M

    def trigger(self, at_m: float) -> None:
        asked = TriggeredEffect(burst(LEVEL_DB, 200), 1, position_m=at_m)
        outcome, _ = self.pipeline.control(ControlStep(trigger=asked), self.time_ns)
        is_off = at_m > self.pipeline.device.bar.length_m and not self.near(at_m)
        assert (outcome is Outcome.OFF_BAR) == is_off or outcome is Outcome.QUIET

    def near(self, at_m: float) -> bool:
        return any(abs(finger.held_m - at_m) < CLOSEST_M for finger in self.pipeline.player.fingers.values())

    def look(self) -> None:
        """No finger beside the bar is placed; whatever is wanted has a command."""
        pipeline, length_m = self.pipeline, self.pipeline.device.bar.length_m
        placement = pipeline.wanted.placement
        assert pipeline.wanted == pipeline.player.wanted
        assert placement is None or all(0 <= at_m.real <= length_m for at_m in placement.position_m)
        assert all(0 <= finger.held_m.real <= length_m for finger in pipeline.player.lifted)
        assert (pipeline.command() == SILENCE) == (placement is None)


@given(st.lists(steps, max_size=30))
def test_whatever_fingers_do_over_changes_of_the_bar_only_those_on_it_are_placed(taken: list[Step]) -> None:
    story = Story(open_pipeline(RIG.recording, bar(), EVERYTHING, RIG.renderer))
    for kind, value in taken:
        story.take(kind, value)


def run_over(
    rig_class: type[Rig], frames: Recording, effects: Effects, coming: list[tuple[int, Device]], *, has_clicks: bool
) -> Rig:
    """A run whose bars come so many ms after its beginning."""
    line = VirtualLine()
    updates = Later(line)
    clicks = varied_clicks(bar(), missing=10**6) if has_clicks else RIG.clicks
    rig = rig_class(frames, line, effects=effects, device=bar(), clicks=clicks, updates=updates)
    renderings = ((at_ms, rendering_for(rig, device, has_clicks=has_clicks)) for at_ms, device in coming)
    updates.coming = [(rig.start_ns + at_ms * MS, rendering) for at_ms, rendering in renderings]
    return rig.run()


def test_a_finger_beside_the_new_bar_is_silenced_and_the_run_goes_on() -> None:
    frames = recording_of(*held(0.0, 0.4, (1, 0.9)), *held(0.4, 0.6, (1, 0.9), (2, 0.2)), (0.6, report(lifted=[1, 2])))
    rig = run_over(Rig, frames, HELD, [(100, bar(0.5))], has_clicks=False)
    assert [bool(event.channels[0].amplitude) for event in rig.log] == [True, False, True, False]
    felt, silenced, *_ = (event.device_time_us for event in rig.log)
    assert 98_000 <= silenced - felt <= 110_000
    placements = [record.placement for record in rig.trace]
    assert [None if each is None else len(each.position_m) for each in placements] == [1, None, 1, None]


@pytest.mark.parametrize("seed", first_quick(range(5)))
def test_the_compiled_step_follows_changes_of_the_bar(fast_library: ctypes.CDLL, seed: int) -> None:
    class FastRig(Rig):
        library = fast_library

    random = np.random.default_rng(seed)
    frames, effects = recording_of(*random_frames(random, 60)), Effects(random_rules(random, DEVICE))
    made = [bar(float(random.choice([0.3, 0.6, 1.0])), int(random.integers(1, 6))) for _ in range(12)]
    coming = [(100 * (1 + i), device) for i, device in enumerate(made)]
    slow, fast = (run_over(each, frames, effects, coming, has_clicks=True) for each in (Rig, FastRig))
    assert fast.trace == slow.trace
    assert fast.log == slow.log
    assert fast.loop.counters == slow.loop.counters and slow.loop.counters.swaps > 5


@pytest.mark.parametrize("silence_s", [0.05, 0.5])
def test_another_silence_counts_for_the_fingers_that_are_down(silence_s: float) -> None:
    """Time that is due brings a release: nothing is due in vain, for which the loop would not wait."""
    rig = Rig(recording_of((0.0, report((1, 0.1)))), effects=HELD)
    pipeline = open_pipeline(rig.recording, DEVICE, HELD, rig.renderer)
    pipeline.step(rig.recording.reports[0].data, 0)
    axis = replace(DEVICE.touch_axis, silence_s=silence_s)
    pipeline.change_table(rendering_for(rig, replace(DEVICE, touch_axis=axis)))
    assert pipeline.due_ns == 1e9 * silence_s
    assert list(pipeline.commands_due(round(1e9 * silence_s) - 1)) == [] and pipeline.touches
    assert list(pipeline.commands_due(round(1e9 * silence_s))) == [SILENCE]
    assert pipeline.is_at_rest
