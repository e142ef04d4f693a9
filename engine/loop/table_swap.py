"""Changes to another table while a loop runs.

A new table comes verified and rendered from another process, so the loop only has to change its look-up between two
frames and, where it differs, to bring the basis of clicks over. Three ways, by what differs from the table that plays:

1. Same limits, same basis (or no clicks): the pipeline changes at once. This is the ordinary case, since the basis
   depends on actuators, bands and lengths of clicks only, not on what was solved.
2. Same limits, another basis: it goes over in pieces while clicks of the old one play; the pipeline changes when the
   device confirms. A device that is armed again meanwhile lost the transfer, and it begins again.
3. Other limits, or a device that has no room for two bases: a new session, and that only while no finger is down and
   no effect is under way, because the device falls silent for the handshake.

A newer table replaces one that is under way. A table that was encoded for another wire is ignored.
"""

from collections.abc import Callable, Container
from dataclasses import replace
from typing import Protocol

from engine.loop.pipeline import Pipeline
from engine.render.prepared import Rendering
from firmware_link.host.link_values import Armed, BasisRefused, BasisReplaced, Event, LinkState
from firmware_link.host.session import Session
from firmware_link.protocol.basis import Basis


class Updates(Protocol):
    """Source of new tables while a loop runs."""

    def fileno(self) -> int:
        """Readable when `poll` has something to do."""

    def poll(self) -> Rendering | None:
        """The newest table, once it is here whole; never waits."""


class TableSwap:
    """Brings new tables to one pipeline and the basis of its device; `on_swap` is called after each change."""

    def __init__(self, updates: Updates, pipeline: Pipeline, session: Session, on_swap: Callable[[], None]) -> None:
        self.descriptor = updates.fileno()
        self._updates, self._pipeline, self._session = updates, pipeline, session
        self._on_swap = on_swap
        self._coming: Rendering | None = None
        self._is_handed_over = self._needs_session = False

    def look(self, readable: Container[int] | None) -> None:
        """Take a table that has come, and go on with the one that is under way; `readable` None: not known."""
        if readable is None or self.descriptor in readable:
            rendering = self._updates.poll()
            if rendering is not None and rendering.renderer.suits_device_of(self._pipeline.answerer.renderer):
                self._coming, self._is_handed_over, self._needs_session = rendering, False, False
        coming, link = self._coming, self._session.link
        if coming is None or self._is_handed_over or link.state is not LinkState.READY:
            return
        if self._needs_session or replace(coming.configuration, basis=None) != replace(link.configuration, basis=None):
            if self._pipeline.is_at_rest:
                self._swap(coming)
                link.reconfigure(coming.configuration)
                self._session.connect()
        elif coming.basis is None or _is_same(coming.basis, link.configuration.basis):
            self._swap(coming)
        else:
            link.replace_basis(coming.basis)
            self._is_handed_over = True

    def act_on(self, event: Event) -> None:
        """Follow what the device says of the basis."""
        match event:
            case Armed():
                self._is_handed_over = False
            case BasisReplaced() if self._coming is not None:
                self._swap(self._coming)
            case BasisRefused():
                self._is_handed_over, self._needs_session = False, True

    def _swap(self, coming: Rendering) -> None:
        self._coming = None
        self._pipeline.change_table(coming)
        self._on_swap()


def _is_same(one: Basis, other: Basis | None) -> bool:
    return other is not None and one.hash == other.hash
