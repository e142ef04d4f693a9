"""The commands that the engine hands to the link: hold a drive, or play a click once."""

from typing import NamedTuple

from base.errors import TactableError
from firmware_link.host.link import Link
from firmware_link.protocol.basis import EncodedClick


class RendererError(TactableError, ValueError):
    """The table, the device description and the connected device do not belong together; the message has the remedy."""


class DriveCommand(NamedTuple):
    """Hold this drive until the next command; no bytes are silence."""

    drive: bytes
    frequency_hz: float | None = None  # of all actuators; None for silence, and for several frequencies

    def hand_to(self, link: Link) -> None:
        """Send this next, in place of a command that waits."""
        link.set_drive(self.drive)


class PlayCommand(NamedTuple):
    """Play a click once, then silence."""

    click: EncodedClick
    frequency_hz: float | None = None  # always None: a click has no single frequency

    def hand_to(self, link: Link) -> None:
        """Send this next, in place of a command that waits."""
        link.set_play(self.click)


Command = DriveCommand | PlayCommand
SILENCE = DriveCommand(b"")


class Rendered(NamedTuple):
    """A command, and whether it reaches the wanted level with quiet fingers kept quiet."""

    command: Command
    is_achieved: bool
