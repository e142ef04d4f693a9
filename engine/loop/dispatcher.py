"""Commands to the link, and what became of each: the loop's outgoing half.

States: a command is *pending* from when the link has it until the port has taken it, a newer command replaces it, or
the run ends. At most one command is pending, and the latest wins: nothing stale is sent after a stall. `held` is the
drive that the device holds unless a waveform plays, sent or about to be sent. A command that equals `held` is not sent
again: a drive would fade out and in, and silence would cut a click, which is played to its end
(engine.effects.effect_player says why).

Each command's `CommandRecord` is noted when it is handed over and completed when its fate is known; `take_records`
gives the records of a pass.
"""

from collections.abc import Callable, Sequence

from engine.loop.observer import CommandRecord, Fate, LoopCounters
from engine.render.renderer import SILENCE, Command, DriveCommand
from firmware_link.host.session import Session


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
