"""An effect under way: the walk of one finger through the segments of an envelope."""

from engine.effects.rules import Effect, Rule, Segment, Trigger
from engine.touch import Touch


class Play:
    """An effect under way: its present level, whether that is a click, and when it changes."""

    def __init__(
        self,
        effect: Effect,
        began_at: Touch,
        start_ns: int,
        condition_end_ns: int | None,
        click_length_ns: int,
        *,
        level_change_db: float = 0.0,
        trigger: Trigger | None = None,
        owner: int | None = None,
    ) -> None:
        self.trigger = trigger  # the event of the rule that began it; None: a program did, whose number is `owner`
        self.owner = owner
        self.began_at = began_at
        self._click_length_ns = click_length_ns
        self.level_db: float | None = None  # with the change of its rule or trigger, without bounds; None: quiet
        self._level_change_db = level_change_db
        self.click_ns: int | None = None
        self.change_ns: int | None = start_ns
        self._condition_end_ns = condition_end_ns
        self.effect, self._next = effect, 0
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
