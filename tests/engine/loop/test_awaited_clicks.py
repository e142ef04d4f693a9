"""Laws of clicks that no table holds: asked for once, played in time or remembered, and never played late."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from engine.device import Device
from engine.effects import Effects, Rule, Trigger
from engine.effects.rules import click
from engine.loop.answerer import ANSWER_WITHIN_NS
from engine.table import ClickEntry
from engine.touch import Placement
from firmware_link.emulator import Cause
from tests.engine.loop.rig import DEVICE, Rig, held, recording_of, report
from tests.engine.made_clicks import click_of, in_zones, made_clicks, number_of
from tests.engine.made_states import LEVEL_DB
from tests.tools.virtual import MS, VirtualLine

RUNS_BOTH_WAYS = True
RULES = Effects((Rule(Trigger.TOUCH, click(LEVEL_DB)),))
# The table has clicks of one finger only. One rests in the middle of zone I from the start, another taps in zone V.
TABLE = made_clicks(DEVICE, [click_of(DEVICE, in_zones(DEVICE, [zone])) for zone in range(5)])
RESTING = [(1, 0.1)]
TAP = [*RESTING, (2, 0.9)]
BOTH = in_zones(DEVICE, [4], [0])


@dataclass
class Solving:
    """Solves each click `takes_ms` after it was asked for."""

    line: VirtualLine
    takes_ms: float
    fingerprint: str = DEVICE.fingerprint
    asked: list[tuple[int, Placement]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._answered = 0

    def fileno(self) -> int:
        return -2

    def ask_for_click(self, placement: Placement, device: Device) -> None:
        assert device is DEVICE
        self.asked.append((self.line.time_ns, placement))

    def poll(self) -> Sequence[tuple[str, ClickEntry]]:
        ready = [at for at_ns, at in self.asked if self.line.time_ns >= at_ns + self.takes_ms * MS]
        found, self._answered = ready[self._answered :], len(ready)
        return [(self.fingerprint, click_of(DEVICE, placement)) for placement in found]


def run(takes_ms: float, *, taps: int = 1, fingerprint: str = DEVICE.fingerprint, solves: bool = True) -> Rig:
    """A finger comes, and from 200 ms on another one taps each 200 ms, for 100 ms."""
    frames = held(0.0, 0.2, *RESTING)
    for tap in range(taps):
        start_s = 0.2 * (tap + 1)
        frames += [*held(start_s, start_s + 0.1, *TAP), (start_s + 0.1, report(*RESTING, lifted=[2]))]
        frames += held(start_s + 0.104, start_s + 0.2, *RESTING)
    line = VirtualLine(wakes_every_ns=MS)
    solving = Solving(line, takes_ms, fingerprint) if solves else None
    rig = Rig(recording_of(*frames), line, effects=RULES, clicks=TABLE, solving=solving)
    return rig.run()


def answers(rig: Rig, tap: int = 0) -> list[tuple[float, str]]:
    """What the device began within 0.2 s of a tap: ms after it, and "click" or "drive"."""
    tap_us = rig.start_ns / 1000 + 200_000 * (tap + 1)
    return [
        ((event.device_time_us - tap_us) / 1000, "click" if event.waveform is not None else "drive")
        for event in rig.log
        if 0 <= event.device_time_us - tap_us < 190_000
        and (event.waveform is not None or (event.cause is Cause.SET and event.channels[0].amplitude))
    ]


def test_a_click_that_is_solved_in_time_answers_the_touch_that_waits() -> None:
    rig = run(takes_ms=12)
    ((after_ms, kind),) = answers(rig)
    assert kind == "click" and 12 <= after_ms <= 15
    (event,) = [event for event in rig.log if event.waveform is not None and event.waveform.samples[1, 0] > 1][-1:]
    assert event.waveform is not None and event.waveform.samples[1, 0] == number_of(DEVICE, BOTH)
    assert isinstance(rig.solving, Solving)
    assert [placement for _, placement in rig.solving.asked] == [BOTH]
    counters = rig.loop.counters
    assert (counters.learned, counters.provisional) == (1, 0)


def test_after_25_ms_the_best_that_is_known_answers_and_the_next_touch_gets_the_click() -> None:
    rig = run(takes_ms=60, taps=2)
    ((after_ms, kind),) = answers(rig)
    assert kind == "drive" and ANSWER_WITHIN_NS / MS <= after_ms <= ANSWER_WITHIN_NS / MS + 3
    assert [kind for _, kind in answers(rig, tap=1)] == ["click"]
    assert answers(rig, tap=1)[0][0] < 3
    assert isinstance(rig.solving, Solving)
    assert len(rig.solving.asked) == 1
    provisional = [change for change in rig.trace if change.is_provisional]
    assert [change.placement for change in provisional] == [rig.steady.solved[0][0]]
    assert (rig.loop.counters.learned, rig.loop.counters.provisional) == (1, 1)


def test_the_placement_is_asked_for_at_the_places_and_the_fallback_is_for_the_fingers() -> None:
    rig = run(takes_ms=60)
    assert isinstance(rig.solving, Solving)
    ((_, asked),), ((solved, _), *_) = rig.solving.asked, rig.steady.solved
    assert asked == BOTH and solved != BOTH and solved.is_felt == BOTH.is_felt


def test_without_a_solver_the_best_that_is_known_answers_at_once() -> None:
    rig = run(takes_ms=0, solves=False)
    ((after_ms, kind),) = answers(rig)
    assert kind == "drive" and after_ms < 3
    assert rig.loop.counters.provisional == 1


def test_a_click_of_another_device_is_dropped() -> None:
    rig = run(takes_ms=5, taps=2, fingerprint="that of an earlier table")
    assert [kind for tap in (0, 1) for _, kind in answers(rig, tap)] == ["drive", "drive"]
    assert rig.loop.counters.learned == 0


def test_a_finger_that_lifts_while_its_click_is_solved_gets_nothing_late() -> None:
    frames = [*held(0.0, 0.2, *RESTING), (0.2, report(*RESTING, (2, 0.9))), (0.21, report(*RESTING, lifted=[2]))]
    line = VirtualLine(wakes_every_ns=MS)
    solving = Solving(line, 18.0)
    quiet = Effects((Rule(Trigger.TOUCH, click(LEVEL_DB), zones=frozenset({4})),))
    rig = Rig(recording_of(*frames, *held(0.22, 0.3, *RESTING)), line, effects=quiet, clicks=TABLE, solving=solving)
    rig.run()
    assert answers(rig) == [] and rig.loop.counters.learned == 1
