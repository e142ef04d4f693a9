"""Palms: what the digitizer takes for one loads the bar as a quiet finger, and feels nothing."""

import pytest

from engine.effects.effect_player import EffectPlayer
from engine.effects.rules import ControlStep, Effects, Outcome, Role, Rule, Trigger, TriggeredEffect, burst, click
from engine.touch import Touch, open_digitizer
from engine.touch.finger_tracker import FingerTracker
from tests.engine.loop.rig import DEVICE
from tests.engine.touch.descriptors import BLOB, CONTACT_COUNT, application, finger

MS = 1_000_000
FINGER, PALM, LIFTED, LIFTED_AS_PALM = 3, 1, 2, 0
"""Flags of a contact: it touches, and has confidence."""
SCREEN = application(finger(flags="0942 0947"), CONTACT_COUNT, BLOB)
TOUCH, LIFT = Rule(Trigger.TOUCH, burst(20.0, 500)), Rule(Trigger.LIFT, click(20.0))


class Chain:
    """Reports of one contact through digitizer, tracker and player; a report comes every 8 ms."""

    def __init__(self, *rules: Rule, descriptor: bytes = SCREEN, vendor_id: int = 1) -> None:
        self.digitizer = open_digitizer(descriptor, vendor_id)
        self.tracker = FingerTracker(DEVICE, self.digitizer.surface)
        self.player, self.time_ns = EffectPlayer(Effects(rules)), 0

    def report(self, flags: int, contacts: int = 1) -> float | None:
        """The level that is wanted after it."""
        self.time_ns += 8 * MS
        slot = bytes([flags, 7]) + (500).to_bytes(2, "little") * 2
        frame = self.digitizer.decode_report(b"\x01" + slot + bytes([contacts]), self.time_ns)
        assert frame is not None
        self.player.advance_effects(self.time_ns)
        self.player.take_touches(self.tracker.track(frame), self.time_ns)
        return self.player.wanted.level_db


@pytest.mark.parametrize("trigger", Trigger)
def test_no_event_of_a_palm_has_it_feel(trigger: Trigger) -> None:
    chain = Chain(Rule(trigger, TOUCH.effect, every_m=1e-3))
    assert [chain.report(flags) for flags in (PALM, PALM, LIFTED)] == [None] * 3


def test_a_palm_is_a_quiet_finger_to_those_beside_it() -> None:
    chain = Chain(TOUCH)
    chain.report(PALM)
    (palm,) = chain.player.fingers.values()
    chain.player.take_touches([palm.touch, Touch(8, 0.03, 0)], chain.time_ns)
    assert chain.player.wanted.placement is not None
    assert sorted(
        zip(chain.player.wanted.placement.position_m, chain.player.wanted.placement.is_felt, strict=True)
    ) == [
        (0.03, True),
        (palm.touch.position_m, False),
    ]


def test_a_finger_that_turns_palm_loses_its_effect_and_gets_none_when_it_lifts() -> None:
    for lifts in (LIFTED, LIFTED_AS_PALM):
        chain = Chain(TOUCH, LIFT)
        assert [chain.report(FINGER), chain.report(PALM), chain.report(lifts)] == [20.0, None, None]
        assert chain.digitizer.expire(chain.time_ns + 200 * MS) is None or lifts is LIFTED_AS_PALM


def test_a_finger_that_is_a_palm_only_when_it_lifts_is_one_for_a_frame() -> None:
    chain = Chain(TOUCH, LIFT)
    assert [chain.report(FINGER), chain.report(LIFTED_AS_PALM)] == [20.0, None]
    assert [touch.is_palm for _, touch in chain.tracker.touches.values()] == [True]
    frame = chain.digitizer.expire(chain.time_ns + 200 * MS)
    assert frame is not None and frame.contacts == ()


def test_a_click_that_has_begun_is_played_to_its_end() -> None:
    chain = Chain(Rule(Trigger.TOUCH, click(20.0)))
    levels = [chain.report(FINGER), *(chain.report(PALM) for _ in range(3)), chain.report(PALM)]
    assert levels == [20.0] * 4 + [None]


def test_no_program_has_a_palm_feel() -> None:
    chain = Chain()
    chain.report(PALM)
    trigger = TriggeredEffect(TOUCH.effect, 1, 7, None, 0.0)
    by_rules = ControlStep(role=Role(7, False, 1))
    assert chain.player.control(by_rules, chain.time_ns) is Outcome.DONE
    assert chain.player.control(ControlStep(trigger=trigger), chain.time_ns) is Outcome.QUIET
    chain.report(FINGER)
    assert chain.player.control(ControlStep(trigger=trigger), chain.time_ns) is Outcome.DONE


@pytest.mark.parametrize(("blob", "vendor_id", "level_db"), [(BLOB, 1, None), (b"", 1, 20.0), (b"", 0, None)])
def test_certified_devices_and_our_own_reports_alone_are_believed(
    blob: bytes, vendor_id: int, level_db: float | None
) -> None:
    """As the kernel does: others declare confidence, and some never set it."""
    descriptor = application(finger(flags="0942 0947"), CONTACT_COUNT, blob)
    assert Chain(TOUCH, descriptor=descriptor, vendor_id=vendor_id).report(PALM) == level_db
