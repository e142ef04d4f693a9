"""Changes to another table while a loop runs.

A new table comes verified and rendered from another process, so the loop only has to bring the bank of clicks over and
change its look-up between two frames. Three ways, by what differs from the table that plays:

1. Same limits, same bank (or no clicks): the pipeline changes at once.
2. Same limits, another bank: the bank goes over in pieces while the old one plays; the pipeline changes when the device
   confirms. A device that is armed again meanwhile lost the transfer, and it begins again.
3. Other limits, or a device that has no room for two banks: a new session, and that only while no finger is down and
   no effect is under way, because the device falls silent for the handshake.

A newer table replaces one that is under way. A table that was encoded for another wire is ignored.
"""

from collections.abc import Callable, Container
from dataclasses import replace
from typing import Protocol

from engine.loop.pipeline import Pipeline
from engine.render import Rendering
from firmware_link.host.link_values import Armed, BankRefused, BankReplaced, Event, LinkState
from firmware_link.host.session import Session


class Updates(Protocol):
    """Where new tables come from while a loop runs."""

    def fileno(self) -> int:
        """Readable when `poll` has something to do."""

    def poll(self) -> Rendering | None:
        """The newest table, once it is here whole; never waits."""


class TableSwap:
    """Brings new tables to one pipeline and the bank of its device.

    `bank_data` are the bytes of the bank that the link is configured with; `on_swap` is called after each change.
    """

    def __init__(
        self, updates: Updates, pipeline: Pipeline, session: Session, bank_data: bytes, on_swap: Callable[[], None]
    ) -> None:
        self.descriptor = updates.fileno()
        self._updates, self._pipeline, self._session = updates, pipeline, session
        self._bank_data, self._on_swap = bank_data, on_swap
        self._coming: Rendering | None = None
        self._is_handed_over = self._needs_session = False

    def look(self, readable: Container[int] | None) -> None:
        """Take a table that has come, and go on with the one that is under way; `readable` None: not known."""
        if readable is None or self.descriptor in readable:
            rendering = self._updates.poll()
            if rendering is not None and rendering.renderer.suits_device_of(self._pipeline.renderer):
                self._coming, self._is_handed_over, self._needs_session = rendering, False, False
        coming, link = self._coming, self._session.link
        if coming is None or self._is_handed_over or link.state is not LinkState.READY:
            return
        if self._needs_session or replace(coming.configuration, bank=None) != replace(link.configuration, bank=None):
            if self._pipeline.is_at_rest:
                self._swap(coming)
                link.reconfigure(coming.configuration)
                self._session.connect()
        elif coming.bank is None or coming.bank_data == self._bank_data:
            self._swap(coming)
        else:
            link.replace_bank(coming.bank, coming.bank_data)
            self._is_handed_over = True

    def act_on(self, event: Event) -> None:
        """Follow what the device says of the bank."""
        match event:
            case Armed():
                self._is_handed_over = False
            case BankReplaced() if self._coming is not None:
                self._swap(self._coming)
            case BankRefused():
                self._is_handed_over, self._needs_session = False, True

    def _swap(self, coming: Rendering) -> None:
        self._coming, self._bank_data = None, coming.bank_data
        self._pipeline.change_table(coming)
        self._on_swap()
