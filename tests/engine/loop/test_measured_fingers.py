"""Laws of fingers that are measured beside a loop: a steady drive is played anew for them, also from a new table."""

from collections.abc import Sequence
from dataclasses import dataclass

import pytest

from engine.steady.cases import MeasuredFinger
from firmware_link.host.link_values import Event
from tests.engine.loop.rig import BURSTS, DEVICE, HELD, Rig, held, recording_of, rendering_of
from tests.engine.loop.test_table_swap import Later
from tests.tools.virtual import MS, VirtualLine

RUNS_BOTH_WAYS = True
FINGER = MeasuredFinger(0.1 * DEVICE.bar.length_m, 0.7, 0.1)


@dataclass
class OneFinger:
    """Tells one finger at a time, and hears nothing of the board."""

    line: VirtualLine
    at_ns: int
    is_listening = False
    told = False

    def fileno(self) -> int:
        return -2

    def poll(self) -> Sequence[MeasuredFinger] | None:
        if self.told or self.line.time_ns < self.at_ns:
            return None
        self.told = True
        return [FINGER]

    def begin_stream(self) -> None:
        pytest.fail("the board is not listened to")

    def take_event(self, event: Event) -> None:
        pytest.fail(f"the board is not listened to: {event}")


class MeasuringRig(Rig):
    """A finger in zone I for half a second, which is measured after 100 ms."""

    def __init__(self, **more: object) -> None:
        line = VirtualLine(wakes_every_ns=MS)
        told, self.later = OneFinger(line, 0), Later(line)
        recording = recording_of(*held(0.0, 0.5, (1, 0.1)))
        super().__init__(recording, line, measuring=told, updates=self.later, **more)  # type: ignore[arg-type]
        told.at_ns = self.start_ns + 100 * MS


def test_a_steady_drive_is_played_anew_for_the_finger_that_was_measured() -> None:
    rig = MeasuringRig().run()
    assert rig.played()[:2] == [101.0, 101.06]
    began_ms = [(1000 * event.device_time_us - rig.start_ns) / MS for event in rig.log[:2]]
    assert began_ms[1] == pytest.approx(100, abs=5)


def test_a_drive_that_follows_a_click_s_time_is_not_begun_for_it() -> None:
    """Bursts end after 50 ms: where nothing is played any more, a measured finger brings nothing."""
    rig = MeasuringRig(effects=BURSTS).run()
    assert rig.steady.measured == [FINGER] and 101.06 not in rig.played()


def test_a_new_table_knows_the_fingers_that_were_measured() -> None:
    rig = MeasuringRig()
    assert rig.session.link.capabilities is not None
    coming = rendering_of(rig.session.link.capabilities, HELD, rig.clicks, always_hz=None)
    rig.later.coming = [(rig.start_ns + 200 * MS, coming)]
    rig.run()
    assert coming.renderer.steady.measured == [FINGER]  # type: ignore[attr-defined]
