"""The command for what is wanted; a click that the table does not hold is waited for while it is solved.

A steady drive, and a click that the table holds, are answered at once. A click that it does not hold (three fingers and
more) is *awaited* where clicks are solved beside the loop, which takes some milliseconds. On a machine that is busy it
may take longer than the click would last: it is played all the same, but not after `patience_ns`. Where nobody solves
it, the steady drive for the same fingers is the answer. The drive of fingers that move keeps the frequency that they
have, where it can.
"""

from engine.effects.effect_player import NOTHING, Wanted
from engine.render.renderer import Command, Renderer
from engine.table import ClickEntry
from engine.touch import Placement

SAME_FINGER_M = 5e-3  # a finger that is farther away than this from one report to the next is taken for another one


LATEST_NS = 100_000_000  # a click that comes later after its touch feels as a fault: it is not played


class Answerer:
    """Finds the command for what is wanted, and waits for one click at a time."""

    def __init__(self, renderer: Renderer) -> None:
        self.renderer = renderer
        self.awaits_clicks = False  # whether clicks that are not known are solved beside the loop
        self.patience_ns = LATEST_NS  # for how long after its touch a click is awaited
        self.awaited: Placement | None = None  # the fingers whose click is waited for; None: no click is
        self.wanted_then = NOTHING  # what the click that is awaited is for
        self.latest_ns: int | None = None  # when nothing is waited for any more; None: no click is
        self._held = HeldDrive()

    def answer(self, wanted: Wanted) -> Command | None:
        """The command for what is wanted; None where its click is awaited from now on."""
        command = self._render(wanted)
        if command is None and self.awaits_clicks and wanted.click_ns is not None:
            self.awaited, self.wanted_then = wanted.placement, wanted
            self.latest_ns = wanted.click_ns + self.patience_ns
            return None
        return self._fallback(wanted) if command is None else command

    def answer_now(self, wanted: Wanted) -> Command:
        """The command for what is wanted, without waiting: the steady drive where the click is not known."""
        command = self._render(wanted)
        return self._fallback(wanted) if command is None else command

    def stop_waiting(self) -> None:
        """Await no click any more."""
        self.awaited = self.latest_ns = None

    def learn(self, click: ClickEntry) -> bool:
        """Add a click that was solved beside the loop; whether it was awaited, and is no more."""
        self.renderer.clicks.learn(click)
        if click.placement != self.awaited:
            return False
        self.stop_waiting()
        return True

    def change_renderer(self, renderer: Renderer, wanted: Wanted) -> None:
        """Answer from another table; a click that is awaited is awaited for the fingers on its bar, if it is wanted."""
        self.renderer = renderer
        if self.awaited is not None:
            if wanted.click_ns is None:
                self.stop_waiting()
            else:
                self.awaited, self.wanted_then = wanted.placement, wanted

    def _render(self, wanted: Wanted) -> Command | None:
        placement, level_db, click_ns = wanted
        held_hz = self._held.frequency_for(placement)
        command = self.renderer.render(placement, level_db, click_ns is not None, held_hz)
        self._held.note(placement, command)
        return command

    def _fallback(self, wanted: Wanted) -> Command:
        placement, level_db, _ = wanted
        assert placement is not None and level_db is not None  # only a click may be unknown
        return self.renderer.fallback(placement, level_db)


class HeldDrive:
    """Remembers the steady drive of the fingers, whose frequency the next drive keeps where it can."""

    def __init__(self) -> None:
        self._placement: Placement | None = None
        self._frequency_hz: float | None = None

    def frequency_for(self, placement: Placement | None) -> float | None:
        """The frequency that these fingers have; None where they have no steady drive, or are others."""
        before = self._placement
        if placement is None or before is None or placement.is_felt != before.is_felt:
            return None
        moved_m = (abs(at_m - old_m) for at_m, old_m in zip(placement.position_m, before.position_m, strict=True))
        return self._frequency_hz if max(moved_m) < SAME_FINGER_M else None

    def note(self, placement: Placement | None, command: Command | None) -> None:
        """Take the command that these fingers get now; None: it is awaited."""
        self._frequency_hz = None if command is None else command.frequency_hz
        self._placement = placement
