"""A finger of the effect player, and its effect under way: a walk through the segments of an envelope."""

from base.points import clip_point
from engine.effects.rules import Rule, Segment, TriggeredEffect
from engine.touch import Touch

FOLLOW_M = 0.5e-3  # a finger that drives are made for is followed once it is farther away; drives allow for 1 mm
STILL_M = 2e-3  # a finger this close to its resting place is still: a fingertip rolls by a millimetre
SPEED_NS = 15_000_000  # a speed is taken over this time, up to twice: of 5 to 18 ms, the least errors in recordings
FURTHEST_M = 15e-3  # a click is made for a finger at most this far ahead: 500 mm/s; beyond, recordings show no law


class Play:
    """An effect under way: its present level, whether that is a click, and when it changes."""

    def __init__(
        self,
        by: Rule | TriggeredEffect,
        began_at: Touch,
        start_ns: int,
        condition_end_ns: int | None,
        click_length_ns: int,
    ) -> None:
        # The event of the rule that began it, or the number of the program that did.
        self.trigger = by.on if isinstance(by, Rule) else None
        self.owner = None if isinstance(by, Rule) else by.owner
        self.began_at = began_at
        self._click_length_ns = click_length_ns
        self.level_db: float | None = None  # with the change of its rule or trigger, without bounds; None: quiet
        self._level_change_db = by.level_change_db
        self.click_ns: int | None = None
        self.change_ns: int | None = start_ns
        self._condition_end_ns = condition_end_ns
        self.effect, self._next = by.effect, 0
        self._begin_next(start_ns)

    def advance_segments(self, time_ns: int) -> None:
        """Begin and end the segments that are due by `time_ns`."""
        while self.change_ns is not None and self.change_ns <= time_ns:
            self._begin_next(self.change_ns)

    def end_condition(self, time_ns: int) -> None:
        """The event has ended: a held segment ends now, segments of a stated duration play to their end."""
        self._condition_end_ns = time_ns
        if self._is_held:
            self._begin_next(time_ns)

    def goes_on_by(self, rule: Rule) -> bool:
        """Go on by another rule, if that gives the same effect; whether it does. Its level is felt at once."""
        if rule.effect is not self.effect and rule.effect != self.effect:
            return False
        self._level_change_db = rule.level_change_db
        if self.level_db is not None and self.click_ns is None:
            self.level_db = self._level_of(self.effect.envelope[self._next - 1])
        return True

    def _level_of(self, segment: Segment) -> float | None:
        return None if segment.level_db is None else segment.level_db + self._level_change_db

    def cut(self) -> None:
        """End it now, but for a click, which plays to its end."""
        self._next, self._is_held = len(self.effect.envelope), False
        if self.click_ns is None:
            self.level_db = self.change_ns = None

    def _begin_next(self, start_ns: int) -> None:
        segments = self.effect.envelope
        segment = segments[self._next] if self._next < len(segments) else None
        self._next += 1
        self.level_db = self.change_ns = self.click_ns = None
        self._is_held = segment is not None and segment.duration_ns is None and not segment.is_click
        if segment is None:
            return
        level_db = self._level_of(segment)
        if segment.is_click:
            self.click_ns = start_ns
            self.level_db, self.change_ns = level_db, start_ns + self._click_length_ns
        elif segment.duration_ns is not None:
            self.level_db, self.change_ns = level_db, start_ns + segment.duration_ns
        elif self._condition_end_ns is None or self._condition_end_ns > start_ns:
            self.level_db, self.change_ns = level_db, self._condition_end_ns


class Finger:
    """One finger, its effect under way, and the hold that it waits for."""

    __slots__ = (
        *("early_m", "early_ns", "held_m", "hold_ns", "hold_rule", "late_m", "late_ns"),
        *("mark_m", "play", "quiet_for", "rest_m", "rest_rule", "touch"),
    )

    def __init__(self, touch: Touch, time_ns: int) -> None:
        self.touch = touch
        # Where it was at two earlier frames at least SPEED_NS apart; its speed is taken from the earlier one.
        self.early_ns = self.late_ns = time_ns
        self.early_m = self.late_m = touch.position_m
        self.held_m = touch.position_m  # where it is placed
        self.play: Play | None = None
        self.mark_m = touch.position_m  # the position at which the last distance of a drag was complete
        self.rest_m = touch.position_m
        self.rest_rule: Rule | None = None  # the rule on HOLD that covered it when it came to rest
        self.hold_rule: Rule | None = None  # the hold that begins if the finger stays at `rest_m`
        self.quiet_for: frozenset[int] = frozenset()  # the programs that keep it quiet, whatever its rules say
        self.hold_ns = 0  # when that hold begins; undefined without `hold_rule`

    def follow(self, touch: Touch, time_ns: int) -> bool:
        """Take the touch of a frame; whether the finger is placed elsewhere from now on."""
        self.touch, at_m = touch, touch[1]
        if time_ns - self.late_ns >= SPEED_NS:
            self.early_ns, self.early_m = self.late_ns, self.late_m
            self.late_ns, self.late_m = time_ns, at_m
        if abs(at_m - self.held_m) <= FOLLOW_M:
            return False
        self.held_m = at_m
        return True

    def move_to(self, touch: Touch, corner_m: complex) -> None:
        """Go on at another place of a surface up to `corner_m`, as if it had come down and moved there."""
        moved_m = touch.position_m - self.touch.position_m
        self.touch = touch
        self.held_m = clip_point(self.held_m + moved_m, corner_m)
        self.mark_m += moved_m
        self.rest_m += moved_m
        self.early_m += moved_m
        self.late_m += moved_m

    def ahead_m(self, frame_ns: int, ahead_ns: int, corner_m: complex) -> complex:
        """Where it will be `ahead_ns` after the last frame, at `frame_ns`: at most FURTHEST_M on, and on the surface.

        Its speed is a difference over 15 to 30 ms: least squares over five reports predict no better, and arrival
        times as well as scan times (docs/results.md). A step up to FOLLOW_M is ignored, so that the noise of a resting
        finger does not shake its place.
        """
        span_ns, position_m = frame_ns - self.early_ns, self.touch.position_m
        if span_ns < SPEED_NS:
            return self.held_m
        step_m = (position_m - self.early_m) * (ahead_ns / span_ns)
        way_m = abs(step_m)
        if way_m <= FOLLOW_M:
            return self.held_m
        if way_m > FURTHEST_M:
            step_m *= FURTHEST_M / way_m
        return clip_point(position_m + step_m, corner_m)

    @property
    def is_kept_quiet(self) -> bool:
        """Whether it is a palm, or any program keeps it quiet."""
        return self.touch.is_palm or bool(self.quiet_for)
