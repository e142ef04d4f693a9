"""The link and the session of a run with the compiled step: what a frame would be made of, and one written already."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from firmware_link.host.link import Link
from firmware_link.host.link_values import LinkState
from firmware_link.host.session import Port, Session


class Answer(NamedTuple):
    """A packet that was read during a wait, and the frame that was written for it, where there is one."""

    packet: bytes
    frame: bytes  # empty: the compiled step declined
    written: int  # bytes of the frame that the port took
    read_ns: int
    frame_ns: int
    state_ns: int
    asked_ns: int  # the time that the frame was encoded for
    command_ns: int
    written_ns: int


@dataclass
class FastCounters:
    """Commands that the compiled step wrote: confirmed by the loop, or not the loop's, which ends the fast path."""

    answered: int = 0
    mispredicted: int = 0


class FastLink(Link):
    """A link that can say what its next command would be encoded with."""

    def write_ahead(self, fast: Any, lease_ms: int, drive_size: int, now_ns: int) -> bool:
        """Write that into the structure of the compiled step; False where it may not answer.

        Something else is sent before a command, or the device agreed to another lease or size of drives than these.
        """
        outbox, agreed = self._outbox, (self._outbox.lease.duration_ms, len(self._outbox.silent_drive))
        if self.state is not LinkState.READY or self.acknowledgements or outbox.is_waiting:
            return False
        fast.line_free_ns, fast.sequence = self._line.free_ns, self._encoder.sequence
        fast.set_from_ns, fast.play_from_ns = outbox.free_from_ns(now_ns)
        fast.clock_at_ns, fast.clock_middle_ns, fast.clock_drift = self.clock.line()
        return agreed == (lease_ms, drive_size)


class FastSession(Session):
    """A session whose next frame may have been written already."""

    def __init__(self, link: FastLink, port: Port, monotonic_ns: Callable[[], int]) -> None:
        super().__init__(link, port, monotonic_ns)
        self.fast_link = link
        self.fast_counters = FastCounters()
        self.answer: Answer | None = None  # an answer whose frame was written; the next `send` confirms it

    def send(self) -> None:
        """Write what is due, or confirm that it was written; a frame that is not the link's begins a new session."""
        answer, self.answer = self.answer, None
        if answer is None:
            super().send()
        elif self.link.outgoing(answer.asked_ns) == answer.frame:
            self.fast_counters.answered += 1
            self._unsent = answer.frame[answer.written :]
        else:
            self.fast_counters.mispredicted += 1
            self.connect()
