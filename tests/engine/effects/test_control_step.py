"""Laws of what a program may ask of a player: other rules under fingers, triggered effects, fingers kept quiet."""

from dataclasses import replace

import pytest

from engine.effects.rules import (
    ControlStep,
    Effect,
    Effects,
    Outcome,
    Role,
    Rule,
    SceneSettings,
    Segment,
    Trigger,
    TriggeredEffect,
    burst,
    click,
)
from engine.touch.placement import CLOSEST_M
from tests.engine.effects.test_effect_player import MM, MS, Story, pulse, touch

HELD = pulse((None, 20.0))
LONG = pulse((100, 20.0), (100, 10.0))
ALONE = SceneSettings(uses_rule_file=False)
OFF = SceneSettings(is_enabled=False)


class Controlled(Story):
    """A story in which a program speaks, too."""

    def asks(self, time_ms: float, **parts: object) -> Outcome:
        self.until(time_ms)
        outcome = self.player.control(ControlStep(**parts), round(time_ms * MS))  # type: ignore[arg-type]  # its fields
        self.note(time_ms)
        return outcome


def story(*rules: Rule) -> Controlled:
    return Controlled(Effects(rules))


def region(start_mm: float, stop_mm: float, effect: Effect, on: Trigger = Trigger.TOUCH, **more: float) -> Rule:
    after_ns, every_m = round(more.get("after_ms", 0) * MS), more.get("every_mm", 0) * MM
    return Rule(on, effect, region_m=(start_mm * MM, stop_mm * MM), after_ns=after_ns, every_m=every_m)


def test_a_held_effect_ends_with_its_rule_and_goes_on_with_a_rule_that_still_covers_where_it_began() -> None:
    seen = story(region(0, 50, HELD))
    seen.at(0, touch(1, 10))
    seen.asks(30, rules=(region(100, 150, LONG), region(5, 20, HELD)), settings=ALONE)
    seen.asks(60, rules=(region(100, 150, HELD),), settings=ALONE)
    assert seen.until(200).moments == [(0, "F----", 20.0), (60, "-----", None)]


def test_a_finger_that_moved_keeps_the_effect_of_where_it_came_down() -> None:
    seen = story(region(0, 50, HELD))
    seen.at(0, touch(1, 10))
    seen.at(20, touch(1, 120))
    seen.asks(30, rules=(region(0, 50, HELD), region(100, 150, LONG)), settings=ALONE)
    assert seen.until(200).moments == [(0, "F----", 20.0), (20, "--F--", 20.0)]


def test_other_levels_of_the_same_effect_are_felt_at_once() -> None:
    seen = story(region(0, 50, LONG))
    seen.at(0, touch(1, 10))
    seen.asks(40, rules=(replace(region(0, 50, LONG), level_change_db=-6.0),), settings=ALONE)
    assert seen.until(300).moments == [
        (0, "F----", 20.0),
        (40, "F----", 14.0),
        (100, "F----", 4.0),
        (200, "-----", None),
    ]


def test_of_an_effect_that_is_cut_the_click_plays_to_its_end_and_nothing_after_it() -> None:
    two = Effect("two", (*click(20.0).envelope, Segment(40 * MS, None), *click(20.0).envelope))
    seen = story(region(0, 50, two))
    seen.at(0, touch(1, 10))
    seen.asks(10, rules=(), settings=ALONE)
    assert seen.until(300).moments == [(0, "C----", 20.0), (30, "-----", None)]
    assert seen.player.next_change_ns is None


def test_a_hold_is_waited_for_once_whatever_changes_elsewhere() -> None:
    hold = region(0, 50, click(20.0), Trigger.HOLD, after_ms=100)
    seen = story(hold)
    seen.at(0, touch(1, 10))
    for time_ms in (50, 150, 250):
        seen.asks(time_ms, rules=(hold, region(100 + time_ms, 250, HELD)), settings=ALONE)
    assert seen.until(900).moments == [(100, "C----", 20.0), (130, "-----", None)]
    seen.asks(1000, rules=(region(0, 50, click(25.0), Trigger.HOLD, after_ms=200),), settings=ALONE)
    assert seen.until(2000).moments[2:] == [(1200, "C----", 25.0), (1230, "-----", None)]


def test_a_drag_rule_that_comes_under_a_finger_counts_from_there() -> None:
    seen = story()
    seen.at(0, touch(1, 10))
    seen.at(10, touch(1, 38))
    seen.asks(20, rules=(region(0, 50, burst(20.0, 5), Trigger.DRAG, every_mm=10),), settings=ALONE)
    seen.at(30, touch(1, 46))
    assert seen.moments == []
    seen.at(40, touch(1, 49))
    assert seen.moments[0][0] == 40


def test_a_trigger_is_felt_by_its_finger_alone() -> None:
    seen = story()
    seen.at(0, touch(1, 10), touch(2, 110))
    asked = TriggeredEffect(LONG, owner=7, contact_id=2)
    assert seen.asks(10, trigger=asked) is Outcome.DONE
    assert seen.asks(20, trigger=TriggeredEffect(LONG, 7, contact_id=9)) is Outcome.NO_FINGER
    assert seen.until(300).moments == [(10, "q-F--", 20.0), (110, "q-F--", 10.0), (210, "-----", None)]


def test_a_trigger_at_a_place_goes_to_the_finger_there_or_is_felt_without_one() -> None:
    seen = story()
    seen.at(0, touch(1, 10))
    assert seen.asks(10, trigger=TriggeredEffect(HELD, 7, position_m=15 * MM)) is Outcome.DONE
    seen.at(50)
    assert seen.moments == [(10, "F----", 20.0), (50, "-----", None)]
    seen.asks(60, trigger=TriggeredEffect(burst(20.0, 30), 7, position_m=120 * MM))
    assert seen.until(200).moments[2:] == [(60, "--F--", 20.0), (90, "-----", None)]
    assert seen.player.lifted == []


def test_of_two_fingers_near_the_place_of_a_trigger_the_nearer_one_feels_it() -> None:
    for at_mm, felt_mm in ((11.0, 10.0), (16.0, 17.0)):
        seen = story()
        seen.at(0, touch(1, 10), touch(2, 17))
        seen.asks(10, trigger=TriggeredEffect(HELD, 7, position_m=at_mm * MM))
        finger = next(each for each in seen.player.fingers.values() if each.play is not None)
        assert finger.held_m == pytest.approx(felt_mm * MM)


def test_a_later_effect_replaces_the_earlier_one_unless_it_is_just_far_enough_away() -> None:
    seen = story()
    for time_ms in range(1000):
        place_m = (time_ms % 3) * CLOSEST_M / 8
        seen.asks(time_ms, trigger=TriggeredEffect(burst(20.0, 500), 7, position_m=place_m))
        assert len(seen.player.lifted) == 1
    seen.asks(1000, trigger=TriggeredEffect(burst(20.0, 500), 7, position_m=CLOSEST_M))
    assert len(seen.player.lifted) == 2


def test_an_effect_at_a_place_does_not_replace_what_a_finger_left_there() -> None:
    seen = story(region(0, 50, burst(20.0, 100), Trigger.LIFT))
    seen.at(0, touch(0, 10))
    seen.at(10)
    seen.asks(20, trigger=TriggeredEffect(burst(10.0, 30), 7, position_m=10 * MM))
    assert seen.until(200).moments == [(10, "F----", 20.0), (110, "-----", None)]


def test_what_a_program_triggered_ends_with_it_and_nothing_else_does() -> None:
    seen = story(region(0, 50, HELD))
    seen.at(0, touch(1, 10), touch(2, 110), touch(3, 210))
    seen.asks(10, trigger=TriggeredEffect(HELD, 7, contact_id=2))
    seen.asks(20, trigger=TriggeredEffect(HELD, 8, contact_id=3))
    seen.asks(30, trigger=TriggeredEffect(burst(20.0, 90), 7, position_m=160 * MM))
    seen.asks(40, stopped_owner=7)
    assert [moment[1] for moment in seen.moments] == ["F-q-q", "F-F-q", "F-F-F", "F-FFF", "F-q-F"]


def test_a_finger_that_is_kept_quiet_feels_nothing_until_it_may_or_comes_again() -> None:
    tick = region(0, 250, burst(20.0, 5), Trigger.DRAG, every_mm=10)
    lift = region(0, 250, burst(20.0, 5), Trigger.LIFT)
    seen = story(region(0, 50, HELD), tick, lift)
    seen.at(0, touch(1, 10))
    assert seen.asks(10, role=Role(4, True, 7)) is Outcome.NO_FINGER
    seen.asks(10, role=Role(1, True, 7))
    seen.at(20, touch(1, 30))
    assert seen.asks(30, trigger=TriggeredEffect(HELD, 7, contact_id=1)) is Outcome.QUIET
    assert seen.asks(30, trigger=TriggeredEffect(HELD, 7, position_m=31 * MM)) is Outcome.QUIET
    seen.at(40)
    assert seen.moments == [(0, "F----", 20.0), (10, "-----", None)]
    seen.at(50, touch(1, 10))
    assert seen.moments[-1] == (50, "F----", 20.0)
    seen.asks(60, role=Role(1, True, 7))
    assert seen.asks(70, role=Role(1, False, 8)) is Outcome.DONE
    seen.at(80, touch(1, 25))
    assert seen.moments[-1] == (80, "F----", 20.0)


def test_a_finger_is_quiet_while_one_of_the_programs_that_asked_for_it_is_there() -> None:
    def felt(time_ms: float) -> bool:
        return seen.asks(time_ms, trigger=TriggeredEffect(burst(20.0, 1), 9, contact_id=1)) is Outcome.DONE

    seen = story()
    seen.at(0, touch(1, 10))
    for owner in (7, 8):
        seen.asks(10, role=Role(1, True, owner))
    seen.asks(20, stopped_owner=7)
    seen.asks(20, gone_owner=7)
    assert not felt(30)
    seen.asks(40, gone_owner=8)
    assert felt(50)


def everything() -> Controlled:
    """A rule's effect, triggered ones at a finger, at a place and at one that a finger left, at 30 ms."""
    seen = story(
        region(0, 50, HELD), region(50, 100, LONG, Trigger.LIFT), region(200, 250, HELD, Trigger.HOLD, after_ms=40)
    )
    seen.at(0, touch(1, 10), touch(2, 60), touch(3, 110), touch(4, 210))
    seen.asks(10, trigger=TriggeredEffect(HELD, 7, contact_id=3))
    seen.asks(10, trigger=TriggeredEffect(LONG, 8, position_m=160 * MM))
    seen.at(20, touch(1, 10), touch(3, 110), touch(4, 210))
    assert seen.moments[-1] == (20, "FFFFq", 20.0)
    return seen


@pytest.mark.parametrize("click_first", [False, True])
def test_feeling_switched_off_ends_everything_at_once_and_nothing_begins_until_it_is_on(click_first: bool) -> None:
    seen = everything()
    if click_first:
        seen.asks(25, trigger=TriggeredEffect(click(30.0), 8, contact_id=4))
    seen.asks(30, settings=OFF)
    assert seen.moments[-1] == (30, "-----", None) and seen.player.next_change_ns is None
    seen.asks(35, rules=(region(0, 250, HELD),))
    assert seen.asks(35, trigger=TriggeredEffect(LONG, 7, position_m=60 * MM)) is Outcome.OFF
    assert seen.asks(35, trigger=TriggeredEffect(LONG, 7, contact_id=1)) is Outcome.OFF
    seen.at(100, touch(1, 10), touch(5, 60))
    seen.at(110, touch(1, 10))
    seen.asks(120, settings=SceneSettings())
    assert seen.until(500).moments[-1][0] == 30
    seen.at(600, touch(1, 10), touch(6, 120))
    assert seen.moments[-1] == (600, "q-F--", 20.0)


def test_a_finger_that_rests_when_feeling_comes_back_waits_for_its_hold_again() -> None:
    seen = story(region(0, 50, click(20.0), Trigger.HOLD, after_ms=100))
    seen.at(0, touch(1, 10))
    seen.asks(50, settings=OFF)
    seen.asks(200, settings=SceneSettings())
    assert seen.until(900).moments == [(300, "C----", 20.0), (330, "-----", None)]


def test_the_level_of_the_scene_is_added_to_everything_that_is_played_whoever_asked_and_when() -> None:
    seen = everything()
    seen.asks(30, settings=SceneSettings(level_change_db=-8.0))
    assert seen.moments[-1] == (30, "FFFFq", 12.0)
    seen.asks(35, trigger=TriggeredEffect(burst(50.0, 1), 8, contact_id=4, level_change_db=4.0))
    assert seen.moments[-1] == (35, "FFFFF", 46.0)
    for time_ms, change_db, level_db in ((37, -80.0, -20.0), (38, 80.0, 80.0), (39, 0.0, 20.0)):
        seen.asks(time_ms, settings=SceneSettings(level_change_db=change_db))
        assert seen.moments[-1] == (time_ms, "FFFFq", level_db)


def test_changes_of_a_region_and_of_the_scene_add_up_and_are_bounded_once() -> None:
    seen = story(replace(region(0, 50, HELD), level_change_db=-50.0))
    seen.at(0, touch(1, 10))
    assert seen.moments[-1] == (0, "F----", -20.0)
    seen.asks(10, settings=SceneSettings(level_change_db=5.0))
    assert seen.moments[-1] == (0, "F----", -20.0)  # 20 - 50 + 5, not -20 + 5
    seen.asks(20, settings=SceneSettings(level_change_db=35.0))
    assert seen.moments[-1] == (20, "F----", 5.0)


def test_without_the_rule_file_its_effects_end_and_those_of_programs_go_on() -> None:
    seen = everything()
    seen.asks(30, settings=ALONE)
    assert seen.moments[-1] == (30, "q-FFq", 20.0)
    seen.asks(31, settings=SceneSettings())
    assert seen.moments[-1] == (30, "q-FFq", 20.0)  # what has ended does not come back
