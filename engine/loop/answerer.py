"""The command for what is wanted; a click that is being solved beside the loop is waited for, but not for long.

A steady drive, and a click that the table holds, are answered at once. A click that the table does not hold (three
fingers and more) is *awaited* where clicks are solved beside the loop. After `answer_within_ns` the best that is known,
the steady drive for the same fingers, is the answer instead, and is marked as provisional. The drive of fingers that
move keeps the frequency that they have, where it can.
"""

from typing import NamedTuple

from engine.render import Command, Renderer
from engine.render.held import HeldDrive
from engine.table import ClickEntry
from engine.touch import Placement

ANSWER_WITHIN_NS = 25_000_000
"""A touch waits no longer for a click that is being solved: an answer that is later is felt as late."""


class Wanted(NamedTuple):
    """What the fingers are to feel."""

    placement: Placement | None
    """The fingers and their roles; None: no finger feels."""
    level_db: float | None
    """Level under every felt finger, dB above the detection threshold; None: no finger feels."""
    click_ns: int | None
    """When the click began, on the source's time axis; None: what is felt is steady."""


NOTHING = Wanted(None, None, None)


class Answerer:
    """Finds the command for what is wanted, and waits for one click at a time."""

    def __init__(self, renderer: Renderer) -> None:
        self.renderer = renderer
        self.answer_within_ns = ANSWER_WITHIN_NS
        """How long a touch waits for a click that is being solved."""
        self.awaits_clicks = False
        """Whether clicks that are not known are solved beside the loop."""
        self.awaited: Placement | None = None
        """The placement, at places of the table, whose click is waited for; None: no click is."""
        self.latest_ns: int | None = None
        """When the best that is known must answer the touch that waits; None: no touch waits."""
        self.is_provisional = False
        """Whether the last command is the best that was known in time, and not the click that was wanted."""
        self._held = HeldDrive()

    def answer(self, wanted: Wanted, time_ns: int) -> Command | None:
        """The command for what is wanted since `time_ns`; None where its click is awaited from now on."""
        command = self._render(wanted)
        if command is not None:
            return command
        if self.awaits_clicks and wanted.placement is not None:
            self.awaited = self.renderer.at_places(wanted.placement)
        if self.awaited is None:
            return self._best_known(wanted)
        self.latest_ns = time_ns + self.answer_within_ns
        return None

    def answer_now(self, wanted: Wanted) -> Command:
        """The command for what is wanted, without waiting: the best that is known where the click is not."""
        command = self._render(wanted)
        return self._best_known(wanted) if command is None else command

    def stop_waiting(self) -> None:
        """Await no click any more."""
        self.awaited = self.latest_ns = None

    def learn(self, click: ClickEntry) -> bool:
        """Add a click that was solved beside the loop; whether it was awaited, and is no more."""
        self.renderer.learn(click)
        if click.placement != self.awaited:
            return False
        self.stop_waiting()
        return True

    def change_renderer(self, renderer: Renderer, wanted: Wanted) -> None:
        """Answer from another table; a click that is awaited is now awaited at the places of that table.

        A touch that waits is answered by `latest_ns` also where these places are too close for a click. Where its click
        is not wanted any more, since its finger is not on the new bar, no touch waits.
        """
        self.renderer = renderer
        if wanted.placement is None or wanted.click_ns is None:
            self.stop_waiting()
        elif self.awaited is not None:
            self.awaited = renderer.at_places(wanted.placement)

    def _render(self, wanted: Wanted) -> Command | None:
        placement, level_db, click_ns = wanted
        self.is_provisional = False
        held_hz = self._held.frequency_for(placement)
        command = self.renderer.render(placement, level_db, click_ns is not None, held_hz)
        self._held.note(placement, command)
        return command

    def _best_known(self, wanted: Wanted) -> Command:
        placement, level_db, _ = wanted
        assert placement is not None and level_db is not None  # only a click may be unknown
        self.is_provisional = True
        return self.renderer.fallback(placement, level_db)
