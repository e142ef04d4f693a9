"""Plays effects: from touches and time to the placement of the fingers and the level that is wanted now.

Each finger has at most one effect under way, a walk through the segments of its envelope, and at most one hold that it
waits for. A new effect of a finger replaces the one before. Roles and precedence:

- A finger without an effect, or in a quiet segment, is quiet. Two fingers in one zone may have different roles.
- A palm is a quiet finger: it loads the bar, and no rule or program has it feel. A finger that the digitizer takes for
  a palm in mid-touch loses its effect; a click that has begun is played to its end.
- Of several levels the greatest is wanted: a placement has one level for all felt fingers, and no finger may feel less
  than its rule says.
- A click takes precedence over everything steady while it lasts; of two clicks the one that began last. Fingers whose
  click is not played are quiet meanwhile; a click that a later one cut does not come back.
- A click that has begun is played to its end (below).
- A finger that lifts with a rule on LIFT goes on as a lifted finger, felt where it was, until its effect ends.
- Fingers closer than engine.touch.placement.CLOSEST_M are one finger to the bar, which feels if one of them does.
- Of more than engine.touch.placement.MOST_FINGERS the felt ones are placed first, then those that came first.

A click that has begun. This is the one statement of the rule; dispatcher, link and firmware only carry it out. A click
keeps the placement that it began with and lasts its 30 ms: fingers that move, leave, or come without a click of their
own do not change it, and a finger that lifts in mid-click sends nothing. What is wanted then is silence, and below a
click the device holds silence already (`Dispatcher.hand_over`). The reasons: its levels are promised for the whole
waveform, not for a part of it, and quiet fingers would feel the part; and a brush of a finger is to be answered as
fully as a press. Only these end it early: a click that begins later, `enabled` false, the end of the run or of its
lease, and the limits of the device.

Programs (`control`). A program changes the rules, triggers effects and keeps fingers quiet. New rules act on what
fingers do from then on. An effect under way goes on if a rule still gives it where it began, at the level of that rule.
Otherwise it is cut: a click plays to its end, and all else ends at once. A finger at rest waits for a hold only once
for each rule, so that a change elsewhere on the bar begins no second one.

The settings of the scene are state of the player, not of rules and effects, so that they hold for everything that is
played, whoever asked for it and when. The change of level is added when the effects are combined; a click that was
sent already keeps its own. While feeling is off there are no rules and no effects: all that were under way ended at
once, clicks too, and a trigger is refused.

Another bar (`change_bar`). Nobody put a finger down or lifted one, so no rule acts: a finger that is on both bars goes
on with its effect, one that is beside the new bar is gone with it, and one that is new rests. An effect at a place
beyond the end is gone, too, and none begins there.

A finger is placed where it came down. It follows the touch once that is FOLLOW_M away, so that the jitter of a resting
finger changes nothing. A click is made for where each finger will be at the click's peak (`Finger.ahead_m`): a quiet
finger at 100 mm/s is 3 mm further on by then, where it would feel 6 dB more. Steady drives follow the reports.

The placement changes only in `take_touches` and `advance_effects`, and `next_change_ns` is the earliest time at which
`advance_effects` changes it, so the loop can wait for a report or that time, whichever comes first. Time is an
argument; nothing here reads a clock.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

from base.points import is_within
from engine.effects.effect_play import STILL_M, Finger, Play
from engine.effects.rules import (
    ControlStep,
    Effects,
    Outcome,
    Role,
    Rule,
    SceneSettings,
    Trigger,
    TriggeredEffect,
    changed_level,
)
from engine.touch import Placement, Touch
from engine.touch.digitizer import FRAME_SILENCE_NS
from engine.touch.placement import CLOSEST_M, MOST_FINGERS, merged

DEFAULT_CLICK_NS = 30_000_000  # length of a click for which the table states none
_NO_CONTACT = -1
DRAG_REST_NS = 100_000_000  # a drag ends when the finger has not travelled the next distance within this time
_new = tuple.__new__  # the hot path: half the time of calling a named tuple's class


class Wanted(NamedTuple):
    """What the fingers are to feel."""

    placement: Placement | None  # the fingers and their roles; None: no finger feels
    level_db: float | None  # level under every felt finger, dB above the detection threshold; None: no finger feels
    click_ns: int | None  # when the click began, on the source's time axis; None: what is felt is steady


NOTHING = Wanted(None, None, None)


@dataclass(frozen=True)
class Scene:
    """The rules of the run, what programs want, and the rules that are in force by both."""

    of_run: Effects
    effects: Effects  # in force; other rules are another object
    of_programs: tuple[Rule, ...] = ()
    settings: SceneSettings = field(default_factory=SceneSettings)

    def changed(self, rules: tuple[Rule, ...] | None, settings: SceneSettings | None) -> "Scene":
        """The scene with other rules and settings of programs; None: as before."""
        rules, before = self.of_programs if rules is None else rules, self.settings
        settings = before if settings is None else settings
        effects = self.effects
        is_as_before = (settings.is_enabled, settings.uses_rule_file) == (before.is_enabled, before.uses_rule_file)
        if not is_as_before or rules is not self.of_programs:
            below = self.of_run.rules if settings.uses_rule_file else ()
            in_force = (*rules, *below) if settings.is_enabled else ()
            # A rule that plays nothing matters only where another one on its event plays something.
            events = {rule.on for rule in in_force if rule.effect.envelope}
            effects = replace(self.of_run, rules=tuple(rule for rule in in_force if rule.on in events))
        return Scene(self.of_run, effects, rules, settings)

    @cached_property
    def rules(self) -> dict[Trigger, tuple[Rule, ...]]:
        """The rules in force by their events, in order."""
        return {trigger: self.effects.of(trigger) for trigger in Trigger}

    @cached_property
    def follows_moves(self) -> bool:
        """Whether a finger that moves may begin or end an effect."""
        return bool(self.rules[Trigger.HOLD] or self.rules[Trigger.DRAG])

    def rule_for(self, event: Trigger, touch: Touch) -> Rule | None:
        """The first rule on an event that covers the finger; None where no rule does, or where it plays nothing."""
        for rule in self.rules[event]:
            if rule.covers(touch):
                return rule if rule.effect.envelope else None
        return None


class EffectPlayer:
    """Follows the fingers of one bar and their effects.

    Call `take_touches` with the fingers of each frame, and `advance_effects` when `next_change_ns` has come, in the
    order of times.
    """

    def __init__(self, effects: Effects, click_length_ns: int = DEFAULT_CLICK_NS) -> None:
        self.wanted = NOTHING
        self.effect = ""  # name of the effect that is felt now, that of the first finger; "": none is
        self.next_change_ns: int | None = None  # when `advance_effects` is due; None: time alone changes nothing
        self.scene = Scene(effects, effects)
        self.fingers: dict[int, Finger] = {}  # the fingers that touch, by contact id
        self.lifted: list[Finger] = []  # fingers that are gone, their last effect still under way
        self._begun_ns: float = -math.inf  # of the click that began last
        self._corner_m: complex = math.inf  # of the surface
        self.click_length_ns = click_length_ns  # length of the clicks that begin from now on
        self.ahead_ns = 0  # from the scan of a report until the peak of a click that it begins; 0: fingers are at rest
        self._frame_ns = 0  # time of the last frame
        self.joined = self.left_out = 0  # fingers that are one to the bar with another; fingers beyond the most

    def take_touches(self, touches: Sequence[Touch], time_ns: int) -> bool:
        """Set the fingers that touch from now on; False where the placement certainly did not change."""
        fingers, follows_moves = self.fingers, self.scene.follows_moves
        has_changed = follows_moves
        self._frame_ns = time_ns
        for touch in touches:
            finger = fingers.get(touch[0])
            if finger is None:
                self._put_down(touch, time_ns)
                has_changed = True
            else:
                if touch[3] is not finger.touch[3]:
                    was_quiet, finger.touch = finger.is_kept_quiet, touch
                    self._turn_quiet(finger, was_quiet, time_ns)
                    has_changed = True
                if finger.follow(touch, time_ns):
                    has_changed = has_changed or self.wanted.level_db is not None
                if follows_moves:
                    self._move(finger, time_ns)
        if len(fingers) != len(touches):
            self._lift_all_but({touch.contact_id for touch in touches}, time_ns)
            has_changed = True
        if has_changed:
            self._settle()
        return has_changed

    def advance_effects(self, time_ns: int) -> None:
        """Begin and end what is due by `time_ns`."""
        for finger in (*self.fingers.values(), *self.lifted):
            if finger.hold_rule is not None and finger.hold_ns <= time_ns:
                self._begin(finger, finger.hold_rule, finger.hold_ns, None)
                finger.hold_rule = None
            if finger.play is not None:
                finger.play.advance_segments(time_ns)
        self._forget_ended()
        self._settle()

    def control(self, step: ControlStep, time_ns: int) -> Outcome:
        """Take what a program asks for at `time_ns`; what is due by then was taken before."""
        outcome = Outcome.DONE
        self._change_scene(step.rules, step.settings, time_ns)
        ended = (step.stopped_owner, step.gone_owner)
        for finger in (*self.fingers.values(), *self.lifted):
            owner = None if finger.play is None else finger.play.owner
            if finger.play is not None and owner is not None and (step.are_all_gone or owner in ended):
                finger.play.cut()
        for finger in self.fingers.values():
            quiet_for = frozenset() if step.are_all_gone else finger.quiet_for - {step.gone_owner}
            self._keep_quiet(finger, quiet_for, time_ns)
        if step.role is not None and not self._set_role(step.role, time_ns):
            outcome = Outcome.NO_FINGER
        if step.trigger is not None:
            outcome = self._trigger(step.trigger, time_ns)
        self._forget_ended()
        self._settle()
        return outcome

    def change_bar(self, touches: Sequence[Touch], corner_m: complex) -> None:
        """Play on another surface, which reaches from 0 to `corner_m`; `touches` are all fingers on it."""
        self._corner_m = corner_m
        before, self.fingers = self.fingers, {}
        for touch in touches:
            finger = self.fingers[touch.contact_id] = before.get(touch.contact_id) or Finger(touch, self._frame_ns)
            finger.move_to(touch, corner_m)
        self.lifted = [finger for finger in self.lifted if is_within(finger.held_m, corner_m)]
        self.wanted = self.wanted._replace(click_ns=None)  # also a click that goes on is placed on the new bar
        self._settle()

    def _change_scene(self, rules: tuple[Rule, ...] | None, settings: SceneSettings | None, time_ns: int) -> None:
        before, scene = self.scene, self.scene.changed(rules, settings)
        self.scene = scene
        if scene.effects is before.effects:
            return
        for finger in (*self.fingers.values(), *self.lifted):
            play = finger.play
            if play is not None and play.trigger is not None:
                rule = scene.rule_for(play.trigger, play.began_at)
                if rule is None or not play.goes_on_by(rule):
                    play.cut()
            if not scene.settings.is_enabled:
                finger.play = None
        for finger in self.fingers.values():
            hold_rule = scene.rule_for(Trigger.HOLD, finger.touch)
            if _wait_of(hold_rule) != _wait_of(finger.rest_rule):
                self._rest(finger, time_ns)
            else:
                finger.rest_rule = hold_rule
                finger.hold_rule = None if finger.hold_rule is None else hold_rule
            old, new = (each.rule_for(Trigger.DRAG, finger.touch) for each in (before, scene))
            if (old and old.every_m) != (new and new.every_m):  # the marks of a drag are at other distances
                finger.mark_m = finger.touch.position_m

    def _set_role(self, role: Role, time_ns: int) -> bool:
        """Whether the finger is there."""
        finger = self.fingers.get(role.contact_id)
        if finger is not None:
            self._keep_quiet(finger, finger.quiet_for | {role.owner} if role.is_quiet else frozenset(), time_ns)
        return finger is not None

    def _keep_quiet(self, finger: Finger, owners: frozenset[int], time_ns: int) -> None:
        was_quiet, finger.quiet_for = finger.is_kept_quiet, owners
        self._turn_quiet(finger, was_quiet, time_ns)

    def _turn_quiet(self, finger: Finger, was_quiet: bool, time_ns: int) -> None:
        """Where that changed, a finger is kept quiet from now on, or follows its rules again."""
        if finger.is_kept_quiet is was_quiet:
            return
        if finger.play is not None and finger.is_kept_quiet:
            finger.play.cut()
        finger.mark_m = finger.touch.position_m
        self._rest(finger, time_ns)

    def _trigger(self, asked: TriggeredEffect, time_ns: int) -> Outcome:
        if not self.scene.settings.is_enabled:
            return Outcome.OFF
        finger = self._finger_of(asked)
        if finger is None and asked.position_m is None:
            return Outcome.NO_FINGER
        if finger is not None and finger.is_kept_quiet:
            return Outcome.QUIET
        if finger is None:
            assert asked.position_m is not None
            if not is_within(asked.position_m, self._corner_m):
                return Outcome.OFF_BAR
            # A later effect at a place takes the place of the earlier one, so their number is bounded by the bar.
            self.lifted = [
                each
                for each in self.lifted
                if each.touch.contact_id != _NO_CONTACT or abs(each.held_m - asked.position_m) >= CLOSEST_M
            ]
            finger = Finger(Touch(_NO_CONTACT, asked.position_m, None), time_ns)
            self.lifted.append(finger)
        self._begin(finger, asked, time_ns, None)
        return Outcome.DONE

    def _finger_of(self, asked: TriggeredEffect) -> Finger | None:
        """The finger that a trigger names, or the one that touches at its place."""
        if asked.contact_id is not None:
            return self.fingers.get(asked.contact_id)
        position_m = asked.position_m
        assert position_m is not None
        near = [each for each in self.fingers.values() if abs(each.held_m - position_m) < CLOSEST_M]
        return min(near, key=lambda each: abs(each.held_m - position_m), default=None)

    def _forget_ended(self) -> None:
        """Drop the lifted fingers whose effect has ended."""
        self.lifted = [finger for finger in self.lifted if finger.play and finger.play.change_ns is not None]

    def _begin(self, finger: Finger, by: Rule | TriggeredEffect, start_ns: int, condition_end_ns: int | None) -> None:
        finger.play = Play(by, finger.touch, start_ns, condition_end_ns, self.click_length_ns)

    def _put_down(self, touch: Touch, time_ns: int) -> None:
        finger = self.fingers[touch.contact_id] = Finger(touch, time_ns)
        rule = None if touch.is_palm else self.scene.rule_for(Trigger.TOUCH, touch)
        if rule is not None:
            self._begin(finger, rule, time_ns, None)
        if self.scene.rules[Trigger.HOLD]:
            self._rest(finger, time_ns)

    def _move(self, finger: Finger, time_ns: int) -> None:
        if self.scene.rules[Trigger.DRAG]:
            self._drag(finger, time_ns)
        if abs(finger.touch.position_m - finger.rest_m) > STILL_M:
            self._rest(finger, time_ns)
            if finger.play is not None and finger.play.trigger is Trigger.HOLD:
                finger.play.end_condition(time_ns)

    def _drag(self, finger: Finger, time_ns: int) -> None:
        position_m = finger.touch.position_m
        rule = None if finger.is_kept_quiet else self.scene.rule_for(Trigger.DRAG, finger.touch)
        if rule is None:
            finger.mark_m = position_m
            return
        way_m = position_m - finger.mark_m
        if rule.along:
            way_m = rule.along * (way_m * rule.along.conjugate()).real
        steps = int(abs(way_m) / rule.every_m)
        if steps:
            # Marks stay in place on the surface: a finger that moves back meets the same marks again.
            finger.mark_m += steps * rule.every_m * (way_m / abs(way_m))
            self._begin(finger, rule, time_ns, time_ns + DRAG_REST_NS)

    def _rest(self, finger: Finger, time_ns: int) -> None:
        """Start the time of a hold here; it runs until the finger moves on."""
        finger.rest_m = finger.touch.position_m
        finger.rest_rule = self.scene.rule_for(Trigger.HOLD, finger.touch)
        finger.hold_rule = None if finger.is_kept_quiet else finger.rest_rule
        if finger.hold_rule is not None:
            finger.hold_ns = time_ns + finger.hold_rule.after_ns

    def _lift_all_but(self, here: set[int], time_ns: int) -> None:
        for contact_id in self.fingers.keys() - here:
            finger = self.fingers.pop(contact_id)
            rule = None if finger.is_kept_quiet else self.scene.rule_for(Trigger.LIFT, finger.touch)
            if rule is not None:
                finger.hold_rule = None
                finger.early_m = finger.touch.position_m  # it is felt where it was
                self._begin(finger, rule, time_ns, None)
                self.lifted.append(finger)

    def _settle(self) -> None:
        """Combine the effects of all fingers by the precedence above."""
        felt, begun_ns = list[Finger](), self._begun_ns
        level_db = next_ns = click_ns = None
        for fingers in (self.fingers.values(), self.lifted):
            for finger in fingers:
                play = finger.play
                if play is not None:
                    if play.level_db is not None and (play.click_ns is None or play.click_ns >= begun_ns):
                        if play.click_ns == click_ns:
                            felt.append(finger)
                            if level_db is None or play.level_db > level_db:
                                level_db = play.level_db
                        elif click_ns is None or (play.click_ns is not None and play.click_ns > click_ns):
                            felt, level_db, click_ns = [finger], play.level_db, play.click_ns
                    if play.change_ns is not None and (next_ns is None or play.change_ns < next_ns):
                        next_ns = play.change_ns
                if finger.hold_rule is not None and (next_ns is None or finger.hold_ns < next_ns):
                    next_ns = finger.hold_ns
        self.next_change_ns = next_ns
        if click_ns is None or click_ns != self.wanted.click_ns:
            placement = self._place(felt, click_ns) if felt else None
            self.effect = felt[0].play.effect.name if felt and felt[0].play is not None else ""
            level_db = changed_level(level_db, self.scene.settings.level_change_db)
            self.wanted = _new(Wanted, (placement, level_db, click_ns))
            self._begun_ns = begun_ns if click_ns is None else click_ns

    def _place(self, felt: list[Finger], click_ns: int | None) -> Placement:
        """The felt fingers, which may have lifted, and all others that touch; for a click, where they will be."""
        quiet = [finger for finger in self.fingers.values() if finger not in felt]
        fingers = [(finger, True) for finger in felt] + [(finger, False) for finger in quiet]
        self.left_out, fingers = max(0, len(fingers) - MOST_FINGERS), fingers[:MOST_FINGERS]
        if click_ns is not None and self.ahead_ns:
            late_ns = click_ns - self._frame_ns
            ahead_ns = self.ahead_ns + late_ns if late_ns <= FRAME_SILENCE_NS else 0
            ahead = [(finger.ahead_m(self._frame_ns, ahead_ns, self._corner_m), feels) for finger, feels in fingers]
            position_m, is_felt, self.joined = merged(ahead)
            if not self.joined:  # fingers do not pass through each other
                return Placement(position_m, is_felt)
        position_m, is_felt, self.joined = merged((finger.held_m, feels) for finger, feels in fingers)
        return Placement(position_m, is_felt)


def _wait_of(rule: Rule | None) -> tuple[int, str] | None:
    """What a finger at rest waits for: rules with the same wait and the same effect's name are one wait."""
    return None if rule is None else (rule.after_ns, rule.effect.name)
