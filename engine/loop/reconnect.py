"""Lost ports and stopped devices: what a loop does about each, and what ends its run.

A port that is gone, or a device that no longer answers, is a loss. With `reopening` the loop goes on reading touches
and looks for the port; once it is back the session begins with the whole handshake. A device that stopped itself (a
fault, a reboot, an emergency stop) is greeted and armed again only with `greets_again`, since a person may have stopped
it for a reason. Without these both raise a LinkError, which ends the run. Another device than the one that the run
began with always ends it.
"""

from typing import Protocol

from engine.loop.observer import LoopCounters
from engine.render.renderer import Renderer
from firmware_link.host.link_values import Event, Greeted, LinkState
from firmware_link.host.session import Port, Session
from firmware_link.protocol.link_errors import LinkError
from firmware_link.protocol.messages import Fault

_ENDED = (LinkState.STOPPED, LinkState.DISCONNECTED)
_LOST_PORT_NS = 80_000_000  # without a port nothing else wakes the loop for a request to stop


class Reopening(Protocol):
    """What finds a lost port again: `ReopeningPort` has it."""

    def lose(self, now_ns: int) -> None:
        """The port is gone: give it back."""

    def poll(self, now_ns: int) -> Port | None:
        """The port, opened now if it is time to try; None while it is gone."""

    def next_attempt_ns(self) -> int | None:
        """Time at which `poll` tries next; None while the port is open."""


class Reconnection:
    """Loses and finds the port of one session, and begins new sessions."""

    def __init__(
        self, session: Session, counters: LoopCounters, greets_again: bool, reopening: Reopening | None
    ) -> None:
        self.has_port = True
        self._session, self._counters = session, counters
        self._greets_again, self._reopening = greets_again, reopening

    def next_attempt_ns(self, now_ns: int) -> int | None:
        """When to look for the port, or for a request to stop; None while there is a port."""
        if self.has_port or self._reopening is None:
            return None
        attempt_ns, latest_ns = self._reopening.next_attempt_ns(), now_ns + _LOST_PORT_NS
        return latest_ns if attempt_ns is None else min(attempt_ns, latest_ns)

    def lose_port(self, error: LinkError, now_ns: int) -> None:
        """Go on without the port; raises the error where the port is not looked for."""
        if self._reopening is None:
            raise error
        self._counters.losses += 1
        self.has_port = False
        self._session.lose_port()
        self._reopening.lose(now_ns)

    def look_for_port(self, now_ns: int) -> None:
        """Begin a session on the port, where it is back."""
        port = None if self._reopening is None else self._reopening.poll(now_ns)
        if port is not None:
            self._counters.reconnects += 1
            self.has_port = True
            self._session.move_to(port)

    def check(self, event: Event, renderer: Renderer) -> None:
        """Raise LinkError where an event of the link ends the run."""
        match event:
            case Greeted() if not renderer.fits(event.capabilities):
                raise LinkError("another device answered than the one this run began with: start the run again")
            case Fault() if not self._greets_again:
                raise LinkError(f"the device disarmed itself ({event.fault.name}): see to it, then start the run again")

    def greet_again_if_stopped(self) -> None:
        """Begin a new session with a device that stopped; raises LinkError where that ends the run."""
        link = self._session.link
        if link.state not in _ENDED:
            return
        if not self._greets_again:
            raise LinkError("the device is not armed: it was rebooted or stopped; see to it, then start the run again")
        # The acknowledgement of a fault goes out first: the device repeats the fault until it comes.
        if link.next_deadline_ns() is None and not self._session.wants_to_write():
            self._counters.reconnects += 1
            self._session.connect()
