"""Pointers of browsers to the fingers of one digitizer, by way of the reports that the engine reads."""

import os
from collections.abc import Iterator
from dataclasses import replace

import pytest

from engine.touch import open_digitizer
from engine.touch.sources.pointer import REPEAT_NS, SILENT_NS, Phase, PointerEvent, PointerFeed, PointerSource
from tactable.page.pointers import APART_NS, MOST_FINGERS, Pointers
from tests.engine.touch.sources.fake_hid import open_pointer_pipe


class Rig:
    """Pointers that feed a source, and the fingers that a digitizer makes of it."""

    def __init__(self) -> None:
        self.source, self.feed = open_pointer_pipe()
        self.pointers = Pointers()
        self.now_ns = 0
        self._fingers = set[int]()
        self.begin_run()

    def begin_run(self) -> None:
        self._digitizer = open_digitizer(self.source.descriptor, 0, 0)
        self.pointers.feed(self.feed)

    def send(self, browser: int, pointer_id: int, phase: Phase) -> None:
        self.pointers.take_events(browser, [PointerEvent(pointer_id, 0.5, 0.5, phase)], self.now_ns)

    def frames(self) -> list[set[int]]:
        """Contact numbers that were down, in each frame of what was sent."""
        found = list[set[int]]()
        while report := self.source.read(self.now_ns):
            frame = self._digitizer.decode_report(report, self.now_ns)
            found += [] if frame is None else [{contact.contact_id for contact in frame.contacts if contact.tip}]
        return found

    def fingers(self) -> set[int]:
        """Contact numbers that are down, after all that was sent."""
        self._fingers = [self._fingers, *self.frames()][-1]
        return self._fingers


@pytest.fixture
def rig() -> Iterator[Rig]:
    rig = Rig()
    yield rig
    rig.feed.close()
    rig.source.close()


def test_fingers_of_one_message_come_down_in_one_frame_and_a_tap_within_one_is_not_lost(rig: Rig) -> None:
    down = [PointerEvent(number, 0.1 * number, 0.5, Phase.DOWN) for number in (7, 8)]
    rig.pointers.take_events(1, [*down, replace(down[0], phase=Phase.UP)], 0)
    assert rig.frames() == [{0, 1}, {1}]


def test_fingers_that_rest_come_down_one_after_another_in_the_next_run(rig: Rig) -> None:
    rest = [PointerEvent(number, 0.1 * number, 0.5, Phase.MOVE) for number in (7, 8)]
    rig.pointers.take_events(1, rest, 0)
    assert rig.frames() == [{0}, {0, 1}]
    rig.begin_run()
    rig.pointers.take_events(1, rest, 1)  # what a browser says meanwhile makes no second finger come down
    found = list[list[set[int]]]()
    for now_ns in (2, 3, APART_NS + 2):
        rig.pointers.bring_down(now_ns)
        found.append(rig.frames())
    assert found == [[{0}], [], [{0, 1}]]


def test_pointers_of_several_browsers_are_fingers_of_their_own_and_leave_with_them(rig: Rig) -> None:
    for browser in (1, 2):
        for pointer_id in (7, 8):
            rig.send(browser, pointer_id, Phase.DOWN)
    assert rig.fingers() == {0, 1, 2, 3}
    rig.send(1, 8, Phase.UP)
    assert rig.fingers() == {0, 2, 3}
    rig.send(2, 9, Phase.DOWN)
    assert rig.fingers() == {0, 1, 2, 3}
    rig.pointers.leave(2)
    assert rig.fingers() == {0}


def test_an_eleventh_finger_is_refused_until_one_lifts(rig: Rig) -> None:
    for pointer_id in range(MOST_FINGERS + 1):
        rig.send(1, pointer_id, Phase.DOWN)
    assert rig.fingers() == set(range(MOST_FINGERS))
    assert rig.pointers.refused == 1
    rig.send(1, 3, Phase.UP)
    rig.send(1, MOST_FINGERS, Phase.MOVE)
    assert rig.fingers() == set(range(MOST_FINGERS))


def test_a_pointer_that_was_never_down_lifts_nothing_and_one_that_moves_is_pressed(rig: Rig) -> None:
    rig.send(1, 1, Phase.UP)
    rig.send(1, 1, Phase.CANCEL)
    assert (rig.fingers(), rig.pointers.refused) == (set(), 0)
    rig.send(1, 1, Phase.MOVE)
    assert rig.fingers() == {0}


def test_a_finger_that_rests_stays_though_its_browser_is_slow_until_that_has_lost_it(rig: Rig) -> None:
    rig.send(1, 1, Phase.DOWN)
    while rig.now_ns < SILENT_NS:
        rig.now_ns += REPEAT_NS
        rig.pointers.bring_down(min(rig.now_ns, SILENT_NS))
        assert rig.fingers() == {0}
    rig.now_ns = SILENT_NS + 1
    rig.pointers.bring_down(rig.now_ns)
    assert rig.fingers() == set()


def test_an_engine_that_takes_nothing_breaks_nothing() -> None:
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    pointers = Pointers()
    pointers.take_events(1, [PointerEvent(1, 0.5, 0.5, Phase.DOWN)], 0)
    pointers.feed(PointerFeed(writing))
    pointers.bring_down(0)
    source = PointerSource(reading)
    for _ in range(10_000):
        pointers.take_events(1, [PointerEvent(1, 0.5, 0.5, Phase.MOVE)], 0)
    assert pointers.refused > 0
    source.close()
    os.close(writing)
