"""Laws of the rules of a run."""

from engine.effects.rules import DEFAULT_EFFECTS, FULL_SCALE_DB, Effect, Effects, Rule, Segment, Trigger, burst
from engine.touch import Touch

MS = 1_000_000


def test_by_default_every_touch_feels_a_click_at_20_db() -> None:
    (rule,) = DEFAULT_EFFECTS.rules
    assert rule.on is Trigger.TOUCH
    assert rule.effect.envelope == (Segment(None, 20.0, is_click=True),)
    assert DEFAULT_EFFECTS.have_clicks and not Effects((Rule(Trigger.TOUCH, burst(20.0, 1)),)).have_clicks
    assert rule.covers(Touch(1, 0.1, 2)) and rule.covers(Touch(1, 0.1, None))
    assert DEFAULT_EFFECTS.levels_db == (20.0,)


def test_the_levels_are_those_of_all_rules_rising_and_without_pauses() -> None:
    loud = Effect("loud", (Segment(MS, FULL_SCALE_DB), Segment(MS, None), Segment(None, 5.0)))
    effects = Effects((Rule(Trigger.TOUCH, loud), Rule(Trigger.LIFT, burst(20.0, 1)), Rule(Trigger.HOLD, loud)))
    assert effects.levels_db == (5.0, 20.0, FULL_SCALE_DB)
