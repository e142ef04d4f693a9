"""The loop's side of the link: commands and what became of each, and what is done about a lost port or stopped device.

States: a command is *pending* from when the link has it until the port has taken it, a newer command replaces it, or
the run ends. At most one command is pending, and the latest wins: nothing stale is sent after a stall. `held` is the
drive that the device holds unless a waveform plays, sent or about to be sent. A command that equals `held` is not sent
again: a drive would fade out and in, and silence would cut a click, which is played to its end
(engine.effects.effect_player says why).

Each command's `CommandRecord` is noted when it is handed over and completed when its fate is known; `take_records`
gives the records of a pass.

A port that is gone, or a device that no longer answers, is a loss. With `reopening` the loop goes on reading touches
and looks for the port; once it is back the session begins with the whole handshake. A device that stopped itself (a
fault, a reboot, an emergency stop) is greeted and armed again only with `greets_again`, since a person may have stopped
it for a reason. Without these both raise a LinkError, which ends the run. Another device than the one that the run
began with always ends it.
"""

from collections.abc import Callable, Sequence
from typing import Protocol

from engine.loop.observer import CommandRecord, Fate, LoopCounters
from engine.render.renderer import SILENCE, Command, DriveCommand, Renderer
from firmware_link.host.link_values import Event, Greeted, LinkState
from firmware_link.host.session import Port, Session
from firmware_link.protocol.link_errors import LinkError
from firmware_link.protocol.messages import Fault

_ENDED = (LinkState.STOPPED, LinkState.DISCONNECTED)
_LOST_PORT_NS = 80_000_000  # without a port nothing else wakes the loop for a request to stop


class Dispatcher:
    """Hands commands to the link of one session and notes their records; `now_ns` is the loop's clock."""

    def __init__(self, session: Session, now_ns: Callable[[], int]) -> None:
        self.counters = LoopCounters()
        self.session = session
        self.held = SILENCE
        self.play = b""  # the PLAY of the last command that was handed over; empty where that is no click
        self._now_ns = now_ns
        self._records: list[CommandRecord] = []
        self._pending: CommandRecord | None = None
        self._pending_at: int | None = None  # its place in the list; None: observers have it as WAITING
        self._sent_before = 0

    @property
    def is_pending(self) -> bool:
        """Whether the link has a command that is not known to be written."""
        return self._pending is not None

    @property
    def is_sent(self) -> bool:
        """Whether the link has encoded the pending command for the port."""
        return self._pending is not None and self.session.link.counters.sent != self._sent_before

    def hand_over(self, command: Command, *, ends_click: bool = False) -> Fate:
        """Hand a command to the link in place of one not sent yet; SAME where the device holds it already.

        Below a click that sounds the device holds silence, so that only with `ends_click` silence is sent meanwhile.
        The caller notes the record of the command next.
        """
        self.counters.state_changes += 1
        is_same = command == self.held and not ends_click and (self._pending is None or self.is_sent)
        if self._pending is not None:
            self.settle()
        if is_same:
            return Fate.SAME
        link = self.session.link
        self._sent_before = link.counters.sent
        self.held, self.play = (command, b"") if isinstance(command, DriveCommand) else (SILENCE, command.click.play)
        command.hand_to(link)
        return Fate.WAITING

    def note(self, record: CommandRecord) -> None:
        """Keep the record of a report or a change until the end of the pass."""
        if record.fate is Fate.WAITING:
            self._pending, self._pending_at = record, len(self._records)
        self._records.append(record)

    def resume(self) -> None:
        """Hand what is to play by now to a device that was armed again; a click that was not sent is over."""
        if self._pending is not None and self._pending.is_click:
            self.settle()
        if self.held != SILENCE or self._pending is not None:
            self.held.hand_to(self.session.link)

    def settle_if_written(self) -> None:
        """Complete the pending record once the port has taken the whole command."""
        if self._pending is not None and not self.session.wants_to_write() and self.is_sent:
            self.settle()

    def settle(self) -> None:
        """Complete the pending record: its command was written now, or it was replaced or never will be sent."""
        record = self._pending
        if record is None:
            return
        if self.is_sent:
            self.counters.commands += 1
            written_ns = 0 if self.session.wants_to_write() else self._now_ns()
            stamps_ns = (*record.stamps_ns[:5], written_ns)
            fate, sequence = Fate.WRITTEN, self.session.link.drive_sequence
            settled = record._replace(stamps_ns=stamps_ns, fate=fate, drive_sequence=sequence)
        else:
            settled = record._replace(fate=Fate.DROPPED)
        self._pending = None
        if self._pending_at is None:
            self._records.append(settled._replace(report=b"", frame=None))
        else:
            self._records[self._pending_at] = settled

    def take_records(self) -> Sequence[CommandRecord]:
        """The records since the last call; that of a pending command among them is WAITING."""
        records, self._records, self._pending_at = self._records, [], None
        return records


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
