"""Laws of what is to be felt while fingers come, rest, move and go."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from engine.effects.effect_play import FOLLOW_M, FURTHEST_M
from engine.effects.effect_player import EffectPlayer
from engine.effects.rules import Effect, Effects, Rule, Segment, Trigger, burst, click
from engine.touch import Placement, Touch
from engine.touch.placement import CLOSEST_M, MOST_FINGERS

MS = 1_000_000
MM = 1e-3
ZONES = 5

Moment = tuple[float, str, float | None]
"""Time in ms; in each zone F: a finger feels, C: it feels a click, q: it is quiet, "-": neither; and the level."""


def touch(contact_id: int, place_mm: float, zone: int | None = None) -> Touch:
    """Zones of 50 mm from the bar's start, unless it is said otherwise."""
    return Touch(contact_id, place_mm * MM, int(place_mm // 50) if zone is None else zone)


@dataclass
class Story:
    """What a player says over time: a moment for each change."""

    effects: Effects
    moments: list[Moment] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.player = EffectPlayer(self.effects)

    def at(self, time_ms: float, *touches: Touch) -> None:
        """A frame, after all that is due before."""
        self.until(time_ms)
        self.player.take_touches(touches, round(time_ms * MS))
        self.note(time_ms)

    def until(self, time_ms: float) -> "Story":
        player = self.player
        while player.next_change_ns is not None and player.next_change_ns <= time_ms * MS:
            due_ns = player.next_change_ns
            player.advance_effects(due_ns)
            assert player.next_change_ns is None or player.next_change_ns > due_ns
            self.note(due_ns / MS)
        return self

    def note(self, time_ms: float) -> None:
        felt = "F" if self.player.wanted.click_ns is None else "C"
        now = (letters(self.player.wanted.placement, felt), self.player.wanted.level_db)
        before = self.moments[-1][1:] if self.moments else ("-----", None)
        if now != before:
            self.moments.append((time_ms, *now))


def letters(placement: Placement | None, felt: str = "F") -> str:
    zones = ["-"] * ZONES
    if placement is not None:
        for at_m, is_felt in sorted(
            zip(placement.position_m, placement.is_felt, strict=True), key=lambda each: each[1]
        ):
            zones[int(at_m.real / MM // 50)] = felt if is_felt else "q"
    return "".join(zones)


def story(*rules: Rule) -> Story:
    return Story(Effects(rules))


def pulse(*segments: tuple[float | None, float | None]) -> Effect:
    """Durations in ms, None for held; levels."""
    return Effect("pulse", tuple(Segment(None if d is None else round(d * MS), level) for d, level in segments))


HELD = pulse((None, 20.0))


def touched(rule: Rule, *touches: Touch) -> EffectPlayer:
    """A player of one rule that has had one frame, at 0."""
    player = EffectPlayer(Effects((rule,)))
    player.take_touches(touches, 0)
    return player


def places_mm(player: EffectPlayer) -> list[float]:
    assert player.wanted.placement is not None
    return [round(place_m.real / MM, 6) for place_m in player.wanted.placement.position_m]


@pytest.mark.parametrize(("to_mm", "held_mm"), [(60.0, 59.7), (0.1, 0.0), (100.0, 99.7), (99.9, 99.6)])
def test_on_another_bar_a_finger_keeps_its_distance_from_where_it_is_placed(to_mm: float, held_mm: float) -> None:
    player = touched(Rule(Trigger.TOUCH, HELD), touch(1, 20))
    player.take_touches([touch(1, 20.3)], MS)  # too little to be followed
    player.change_bar([touch(1, to_mm)], 100 * MM)
    assert places_mm(player) == [held_mm]


def test_a_finger_has_its_own_role_in_a_gap_and_beside_another_one_of_its_zone() -> None:
    seen = story(Rule(Trigger.TOUCH, HELD, region_m=(0.0, 0.05)))
    seen.at(0, Touch(1, 0.02, None), Touch(2, 0.03, 0), Touch(3, 0.06, 0), Touch(4, 0.12, None))
    assert seen.player.wanted.placement == Placement((0.02, 0.03, 0.06, 0.12), (True, True, False, False))


@given(st.lists(st.tuples(st.integers(1, 100), st.none() | st.integers(0, 40)), min_size=1, max_size=6))
def test_at_any_time_the_level_is_that_of_the_segment(segments: list[tuple[int, int | None]]) -> None:
    player = touched(Rule(Trigger.TOUCH, pulse(*segments)), touch(1, 10))
    levels = [level for duration, level in segments for _ in range(duration)] + [None] * 5
    for time_ms, level in enumerate(levels):
        player.advance_effects(time_ms * MS)
        assert (player.wanted.level_db, letters(player.wanted.placement)[0]) == (level, "-" if level is None else "F")


def test_the_first_rule_that_covers_the_finger_wins() -> None:
    rules = [
        Rule(Trigger.TOUCH, pulse((None, 1.0)), region_m=(0.0, 0.02)),
        Rule(Trigger.LIFT, burst(2.0, 5)),
        Rule(Trigger.TOUCH, pulse((None, 3.0)), zones=frozenset({0, 1})),
        Rule(Trigger.TOUCH, pulse((None, 4.0))),
    ]
    for place_mm, level_db in ((10, 1.0), (30, 3.0), (60, 3.0), (110, 4.0)):
        seen = story(*rules)
        seen.at(0, touch(1, place_mm))
        assert seen.player.wanted.level_db == level_db


def test_a_finger_that_rests_feels_a_hold_once_and_anew_after_it_moved_on() -> None:
    seen = story(Rule(Trigger.HOLD, burst(20.0, 50), after_ns=300 * MS))
    for time_ms in range(0, 1000, 100):
        seen.at(time_ms, touch(1, 1.9 * (time_ms // 100 % 2)))
    for time_ms in range(1000, 1500, 100):
        seen.at(time_ms, touch(1, 20))
    assert seen.moments == [(300, "F----", 20.0), (350, "-----", None), (1300, "F----", 20.0), (1350, "-----", None)]


def test_what_a_hold_holds_ends_when_the_finger_moves_on() -> None:
    seen = story(Rule(Trigger.HOLD, pulse((200, 30.0), (None, 20.0)), after_ns=100 * MS))
    seen.at(0, touch(1, 10))
    seen.at(400, touch(1, 14))
    seen.at(550, touch(1, 18))
    seen.at(640, touch(1, 22))
    assert seen.until(2000).moments == [
        (100, "F----", 30.0),
        (300, "F----", 20.0),
        (400, "-----", None),
        (500, "F----", 30.0),
        # It moved on at 550: what has a duration plays to its end, what would be held never begins, but it rests anew.
        (700, "-----", None),
        (740, "F----", 30.0),
        (940, "F----", 20.0),
    ]


@pytest.mark.parametrize(("along", "across_mm"), [(0.0, 0.0), (1.0, 0.0), (1.0, 7.0)])
def test_a_drag_is_felt_at_marks_that_stay_where_they_are(along: float, across_mm: float) -> None:
    """On a plate the way along it alone counts where a rule says so."""
    seen = story(Rule(Trigger.DRAG, burst(20.0, 5), every_m=5 * MM, along=along))
    path_mm = [10, 12, 14, 16, 18, 14.5, 9.9, 14.9, 15.1, 26]
    for frame, place_mm in enumerate(path_mm):
        seen.at(10 * frame, Touch(1, (place_mm + 1j * across_mm * frame) * MM, 0))
    felt_ms = [time_ms for time_ms, _, level_db in seen.moments if level_db is not None]
    # Marks at 10, 15, 20, 25 mm, each felt when it is reached from another one: 15, 10, 15, then 25 past 20.
    assert felt_ms == [30, 60, 80, 90]


def test_what_a_drag_holds_lasts_until_it_rests() -> None:
    seen = story(Rule(Trigger.DRAG, HELD, every_m=1 * MM))
    for frame in range(20):
        seen.at(50 * frame, touch(1, 10 + 1.5 * frame))
    last_mark_ms = 950
    assert seen.until(5000).moments == [(50, "F----", 20.0), (last_mark_ms + 100, "-----", None)]


def test_the_way_to_a_drag_rule_does_not_count() -> None:
    seen = story(Rule(Trigger.DRAG, burst(20.0, 5), every_m=10 * MM, region_m=(0.05, 0.1)))
    for frame, place_mm in enumerate([10, 30, 45, 51, 54, 56, 70]):
        seen.at(10 * frame, touch(1, place_mm))
    # The last place before the region is 45 mm: the first mark in it is at 55 mm.
    assert [time_ms for time_ms, _, level_db in seen.moments if level_db is not None] == [50, 60]


def test_a_lift_is_felt_where_the_finger_was_and_only_while_it_is_felt() -> None:
    held = Rule(Trigger.TOUCH, pulse((None, 5.0)), zones=frozenset({4}))
    seen = story(Rule(Trigger.LIFT, pulse((20, 20.0), (10, None), (20, 10.0))), held)
    seen.at(0, touch(1, 10), touch(2, 210))
    seen.at(8, touch(1, 60), touch(2, 210))
    seen.at(16, touch(2, 210))
    assert seen.until(1000).moments == [
        (0, "q---F", 5.0),
        (8, "-q--F", 5.0),
        (16, "-F--F", 20.0),
        (36, "----F", 5.0),
        (46, "-F--F", 10.0),
        (66, "----F", 5.0),
    ]
    assert (seen.player.next_change_ns, seen.player.lifted) == (None, [])


def test_one_finger_for_another_in_one_frame_is_a_lift_and_a_touch() -> None:
    seen = story(Rule(Trigger.TOUCH, burst(10.0, 50)), Rule(Trigger.LIFT, burst(30.0, 20)))
    seen.at(0, touch(1, 10))
    seen.at(100, touch(2, 60))
    assert seen.until(1000).moments == [
        (0, "F----", 10.0),
        (50, "-----", None),
        (100, "FF---", 30.0),
        (120, "-F---", 10.0),
        (150, "-----", None),
    ]


def test_the_newest_effect_takes_the_place_of_the_one_under_way() -> None:
    seen = story(
        Rule(Trigger.TOUCH, HELD),
        Rule(Trigger.DRAG, burst(30.0, 10), every_m=5 * MM),
        Rule(Trigger.HOLD, burst(5.0, 10), after_ns=200 * MS),
    )
    seen.at(0, touch(1, 10))
    seen.at(50, touch(1, 16))
    assert seen.until(1000).moments == [
        (0, "F----", 20.0),
        (50, "F----", 30.0),
        (60, "-----", None),
        (250, "F----", 5.0),
        (260, "-----", None),
    ]


def all_triggers() -> Sequence[Rule]:
    return (
        Rule(Trigger.TOUCH, pulse((20, 10.0), (None, 5.0)), zones=frozenset({0, 2, 4})),
        Rule(Trigger.HOLD, pulse((30, 30.0), (None, 2.0)), after_ns=60 * MS),
        Rule(Trigger.DRAG, pulse((7, 20.0), (None, 1.0)), every_m=4 * MM),
        Rule(Trigger.LIFT, pulse((25, 15.0), (5, None), (5, 25.0))),
    )


frames = st.lists(
    st.tuples(st.integers(1, 80), st.dictionaries(st.integers(1, 3), st.integers(0, 249), max_size=3)), max_size=25
)


@given(frames)
def test_touched_zones_are_never_free_and_all_ends_after_the_last_lift(path: list[tuple[int, dict[int, int]]]) -> None:
    seen = story(*all_triggers())
    time_ms = 0
    for step_ms, places_mm in path:
        time_ms += step_ms
        seen.at(time_ms, *(touch(contact_id, place_mm) for contact_id, place_mm in places_mm.items()))
        shown = letters(seen.player.wanted.placement)
        if seen.player.wanted.level_db is not None and not seen.player.joined:
            assert all(shown[place_mm // 50] != "-" for place_mm in places_mm.values())
        assert ("F" in shown) == (seen.player.wanted.level_db is not None)
    seen.at(time_ms + 1)
    seen.until(time_ms + 1000)
    assert (seen.player.wanted.placement, seen.player.wanted.level_db, seen.player.next_change_ns) == (None, None, None)


@given(frames)
def test_looking_more_often_changes_nothing(path: list[tuple[int, dict[int, int]]]) -> None:
    seldom, often = story(*all_triggers()), story(*all_triggers())
    time_ms = 0
    for step_ms, places_mm in path:
        touches = [touch(contact_id, place_mm) for contact_id, place_mm in places_mm.items()]
        for between_ms in range(time_ms + 1, time_ms + step_ms):
            often.player.advance_effects(between_ms * MS)
            often.note(between_ms)
        time_ms += step_ms
        seldom.at(time_ms, *touches)
        often.at(time_ms, *touches)
    assert often.moments == seldom.moments


CLICKS = Effects((Rule(Trigger.TOUCH, click(20.0)),))


def test_fingers_that_come_together_click_together_and_a_later_click_quiets_them() -> None:
    both = [touch(1, 10), touch(2, 210)]
    seen = Story(CLICKS)
    seen.at(0, *both)
    seen.at(20, *both, touch(3, 110))
    assert seen.until(100).moments == [(0, "C---C", 20.0), (20, "q-C-q", 20.0), (50, "-----", None)]


def test_a_click_interrupts_what_is_held_for_its_length() -> None:
    seen = story(Rule(Trigger.TOUCH, HELD, zones=frozenset({0})), Rule(Trigger.TOUCH, click(15.0)))
    seen.at(0, touch(1, 10))
    seen.at(50, touch(1, 10), touch(2, 110))
    assert seen.until(200).moments == [(0, "F----", 20.0), (50, "q-C--", 15.0), (80, "F-q--", 20.0)]


def test_a_click_lasts_as_long_as_the_table_says() -> None:
    player = EffectPlayer(CLICKS, click_length_ns=12 * MS)
    player.take_touches([touch(1, 10)], 5 * MS)
    assert player.next_change_ns == 17 * MS


def test_a_held_drive_follows_the_finger_in_steps_that_its_jitter_does_not_make() -> None:
    player = touched(Rule(Trigger.TOUCH, HELD), touch(1, 40.0))
    placed = [40.0, 40.0, 40.0, 40.0, 40.51, 40.51, 40.0, 41.0, 60.0]
    for n, place_mm in enumerate((40.3, 39.7, 40.0, 40.49, 40.51, 40.1, 40.0, 41.0, 60.0)):
        changed = player.take_touches([touch(1, place_mm)], 0)
        assert (places_mm(player), changed) == ([placed[n]], n > 0 and placed[n] != placed[n - 1])


def test_a_click_keeps_the_placement_that_it_began_with() -> None:
    player = touched(Rule(Trigger.TOUCH, click(20.0), zones=frozenset({0})), touch(2, 110))
    player.take_touches([touch(2, 110), touch(1, 10)], 10 * MS)
    began = player.wanted.placement
    assert began == Placement((0.01, 0.11), (True, False))
    for touches in ([touch(2, 130), touch(1, 20)], [touch(2, 130), touch(1, 20), touch(3, 200)], [touch(1, 20)]):
        player.take_touches(touches, 20 * MS)
        assert (player.wanted.placement, player.wanted.level_db, player.wanted.click_ns) == (began, 20.0, 10 * MS)
    player.advance_effects(40 * MS)
    assert (player.wanted.placement, player.wanted.click_ns) == (None, None)


def test_a_click_that_a_later_one_cut_does_not_come_back() -> None:
    player = EffectPlayer(CLICKS)
    player.take_touches([touch(1, 10)], 0)
    player.take_touches([touch(1, 10), touch(2, 110)], 5 * MS)
    player.take_touches([touch(1, 10)], 10 * MS)
    assert (player.wanted.placement, player.wanted.click_ns) == (None, None)
    player.take_touches([touch(1, 10), touch(3, 110)], 15 * MS)
    assert player.wanted.placement == Placement((0.01, 0.11), (False, True)) and player.wanted.click_ns == 15 * MS


def test_fingers_that_are_one_to_the_bar_are_placed_as_one() -> None:
    near_mm = 0.9 * CLOSEST_M / MM
    near, far = (touch(1, 15), touch(2, 15 + near_mm)), (touch(3, 100), touch(4, 100 + near_mm))
    first_feels = touched(Rule(Trigger.TOUCH, HELD, region_m=(0.0, 0.02)), *near, *far)
    assert (first_feels.wanted.placement, first_feels.joined) == (Placement((0.015, 0.1), (True, False)), 2)
    last_feels = touched(Rule(Trigger.TOUCH, HELD, region_m=(0.02, 0.03)), *near)
    assert last_feels.wanted.placement == Placement(((15 + near_mm) * MM,), (True,))


def test_of_too_many_fingers_the_felt_ones_are_placed_first() -> None:
    fingers = [touch(number, 10 + 20 * number) for number in range(MOST_FINGERS + 2)]
    player = touched(Rule(Trigger.TOUCH, HELD, region_m=(0.2, 0.3)), *fingers)
    placement = player.wanted.placement
    assert placement is not None
    assert (len(placement.position_m), sum(placement.is_felt), player.left_out) == (MOST_FINGERS, 2, 2)
    assert placement.position_m[-1] == 0.23 and 0.17 not in placement.position_m


# Where fingers will be: an island of its own, on a bar of 250 mm.
LAST_CLICKS = Effects((Rule(Trigger.TOUCH, click(20.0), zones=frozenset({4})),))


def slid(effects: Effects, course: Sequence[tuple[float, float]], peak_ms: int = 30) -> EffectPlayer:
    """A player after a finger's course, (ms, mm); its clicks have their peak some time after a report."""
    player = EffectPlayer(effects)
    player.change_bar((), 0.25)
    player.ahead_ns = peak_ms * MS
    for time_ms, place_mm in course:
        player.take_touches([touch(1, place_mm)], round(time_ms * MS))
    return player


def evenly(count: int, from_mm: float = 100.0, step_mm: float = 1.0) -> list[tuple[float, float]]:
    return [(8.0 * n, from_mm + step_mm * n) for n in range(count)]


def made_for(*course: tuple[float, float], comes_mm: float = 240.0, effects: Effects = LAST_CLICKS) -> list[float]:
    """Places, mm, that are made for a finger that comes down in the last frame of another's course."""
    last_ms, last_mm = course[-1]
    player = slid(effects, course[:-1])
    player.take_touches([touch(1, last_mm), touch(2, comes_mm)], round(last_ms * MS))
    return places_mm(player)


@given(st.floats(-1500.0, 1500.0), st.sampled_from((4.0, 8.0, 12.0, 25.0)))
def test_a_click_is_made_for_where_a_finger_that_slides_evenly_will_be(mm_per_s: float, period_ms: float) -> None:
    frames = [(n * period_ms, 100.0 + mm_per_s * n * period_ms / 1000) for n in range(int(50 / period_ms) + 1)]
    here_mm = frames[-1][1]
    frames = [(time_ms, min(max(place_mm, 0.0), 220.0)) for time_ms, place_mm in frames]
    quiet_mm = made_for(*frames)[0]
    assert 0.0 <= quiet_mm <= 250.0
    if 0.0 <= here_mm <= 220.0 and abs(mm_per_s) * 0.03 > 0.51:
        step_mm = max(-15.0, min(15.0, 0.03 * mm_per_s))
        if here_mm + step_mm < 230.0:
            assert quiet_mm == pytest.approx(max(0.0, here_mm + step_mm), abs=1e-6)


@given(st.lists(st.floats(-0.1, 0.1), min_size=1, max_size=30))
def test_the_noise_of_a_finger_at_rest_does_not_move_its_place(noise_mm: list[float]) -> None:
    frames = [(8.0 * n, 100.0 + each) for n, each in enumerate(noise_mm)]
    frames[0] = (0.0, 100.0)
    assert made_for(*frames)[0] == 100.0
    assert 2 * 0.1 * MM * 30 / 15 < FOLLOW_M < FURTHEST_M


def test_of_a_finger_that_has_just_come_no_speed_is_known() -> None:
    assert made_for((0.0, 100.0), (14.0, 102.0))[0] == 102.0
    assert made_for((0.0, 100.0), (15.0, 102.0))[0] == 106.0


def test_a_finger_is_not_where_it_would_run_into_another() -> None:
    assert made_for(*evenly(8, 210.0, 2.0), comes_mm=235.0) == [224.0, 235.0]


def test_a_steady_drive_is_made_for_where_fingers_are() -> None:
    held = Effects((Rule(Trigger.TOUCH, HELD, zones=frozenset({4})),))
    assert made_for(*evenly(8), effects=held) == [107.0, 240.0]


def test_a_click_that_time_begins_counts_the_time_since_the_last_frame_and_not_after_a_silence() -> None:
    for wait_ms, quiet_mm in ((20, 110.0), (60, 105.0)):  # 5 mm in 40 ms; then 50 ms ahead, or a panel that is silent
        late = Effect("late", (Segment(wait_ms * MS, None), Segment(None, 20.0, is_click=True)))
        effects = Effects((Rule(Trigger.TOUCH, late, zones=frozenset({4})),))
        player = slid(effects, evenly(5), peak_ms=20)
        player.take_touches([touch(1, 105.0), touch(2, 240.0)], 40 * MS)
        player.advance_effects((40 + wait_ms) * MS)
        assert places_mm(player)[0] == quiet_mm


def test_a_finger_that_slides_off_is_felt_where_it_was() -> None:
    player = slid(Effects((Rule(Trigger.LIFT, click(20.0)),)), evenly(9))
    player.take_touches([], 72 * MS)
    assert player.wanted.placement == Placement((108.0 * MM,), (True,))


def test_another_bar_moves_no_finger() -> None:
    player = slid(LAST_CLICKS, evenly(9))
    player.change_bar([touch(1, 58.0)], 0.25)
    player.take_touches([touch(1, 59.0), touch(2, 240.0)], 72 * MS)
    assert places_mm(player)[0] == 59.0 + 30 / 8
