"""The compiled step beside the Python pipeline: the same bytes whatever fingers do, and most clicks are its own."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass

import numpy as np
import pytest

from engine.device import Device
from engine.effects import Effects, Rule, Trigger
from engine.effects.rules import click
from engine.loop import CommandRecord, Fate
from engine.render import WhenNotAchieved
from engine.touch.sources.recording import Recording
from tests.engine.loop.fast.scripts import (
    LOUD_DB,
    device_with_gaps,
    random_frames,
    random_rules,
    recording_of,
    varied_clicks,
)
from tests.engine.loop.rig import DEVICE, Rig
from tests.engine.made_entries import LEVEL_DB

GAPS = device_with_gaps()
CLICKS = {device: varied_clicks(device) for device in (DEVICE, GAPS)}
EVERY_CLICK = {device: varied_clicks(device, missing=10**6) for device in (DEVICE, GAPS)}
TOUCH = Effects((Rule(Trigger.TOUCH, click(LEVEL_DB)),))
TOUCH_AND_LIFT = Effects((*TOUCH.rules, Rule(Trigger.LIFT, click(LOUD_DB))))
FAST_LINE_HZ = 1_000_000


@pytest.fixture(scope="module")
def library(fast_library: ctypes.CDLL) -> ctypes.CDLL:
    return fast_library


class FastRig(Rig):
    """With the fast path."""


@dataclass(frozen=True)
class Both:
    """A run with the fast path, and the commands that the run without it gave to reports."""

    fast: Rig
    answered: int
    clicks: list[CommandRecord]
    """Written for a report, one finger or two."""


def both(
    library: ctypes.CDLL,
    recording: Recording,
    effects: Effects,
    device: Device = DEVICE,
    when_not_achieved: WhenNotAchieved = WhenNotAchieved.WARN,
    *,
    is_complete: bool = False,
) -> Both:
    """Run with and without the fast path, which do the same."""
    FastRig.library = library
    clicks = (EVERY_CLICK if is_complete else CLICKS)[device]
    slow, fast = (
        rig(recording, effects=effects, device=device, clicks=clicks, when_not_achieved=when_not_achieved).run()
        for rig in (Rig, FastRig)
    )
    assert fast.trace == slow.trace
    assert fast.log == slow.log
    assert fast.loop.counters == slow.loop.counters
    few = [record for record in slow.trace if record.placement is not None and len(record.placement.position_m) <= 2]
    played = [record for record in few if record.is_click and record.fate is Fate.WRITTEN and not record.drive]
    counters = fast.session.fast_counters
    return Both(fast, counters.answered, [record for record in played if record.report_index is not None])


@pytest.mark.parametrize("device", [DEVICE, GAPS], ids=["zones side by side", "gaps"])
@pytest.mark.parametrize("seed", range(4))
def test_whatever_fingers_do_and_rules_say_the_run_is_the_same(library: ctypes.CDLL, device: Device, seed: int) -> None:
    random, answered, due = np.random.default_rng(seed), 0, 0
    for _ in range(25):
        frames, rules = random_frames(random, 14), random_rules(random, device)
        refuses = WhenNotAchieved.REFUSE if random.random() < 0.3 else WhenNotAchieved.WARN
        found = both(library, recording_of(frames), Effects(rules), device, refuses)
        answered, due = answered + found.answered, due + len(found.clicks)
    # What is left to the loop: clicks that the table has not, and fingers that move under rules on moves.
    assert due > 50
    assert 0.6 * due < answered
