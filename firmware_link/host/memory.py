"""The device's memory for clicks as the host sees it: the basis that it holds, and the transfer of another one."""

from collections.abc import Iterator

from firmware_link.host.line import Line
from firmware_link.host.link_values import BasisRefused, BasisReplaced
from firmware_link.host.outbox import Outbox
from firmware_link.protocol.basis import Basis, EncodedClick, transfer_messages
from firmware_link.protocol.link_errors import LinkError
from firmware_link.protocol.messages import Ack, BasisBegin, BasisChunk, BasisCommit, Result

RETRY_NS = 100_000_000  # beside the time that the line takes; a board that boots answers late, not never
# Each step takes a sequence number. While the device is armed, too many steps within a lease would make a command that
# follows them seem older than the command before them.
ARMED_SPACING_NS = 2_000_000


class BasisTransfer:
    """The steps BASIS_BEGIN, BASIS_CHUNK … and BASIS_COMMIT of one basis, `spacing_ns` apart.

    A repeated step is the same frame under the same sequence, so that an answer names the step that it answers, and
    the device recognises a copy.
    """

    def __init__(self, basis: Basis, line: Line, spacing_ns: int = 0) -> None:
        self.basis = basis
        self.due_ns = 0  # the next frame is due at this time
        self._line, self._spacing_ns = line, spacing_ns
        self._steps: Iterator[BasisBegin | BasisChunk | BasisCommit] = transfer_messages(basis.data)
        self._step: BasisBegin | BasisChunk | BasisCommit | None = next(self._steps)
        self._frame, self._sequence = b"", -1

    @property
    def is_committing(self) -> bool:
        """Whether BASIS_COMMIT was sent and not yet answered: which of the two bases the device holds is unknown."""
        return isinstance(self._step, BasisCommit) and bool(self._frame)

    def next_frame(self, now_ns: int) -> bytes:
        """Frame of the current step, where it is due; empty otherwise."""
        if now_ns < self.due_ns or self._step is None:
            return b""
        if not self._frame:
            self._frame = self._line.encoder.encode(self._step)
            self._sequence = self._line.encoder.sequence
        self.due_ns = now_ns + RETRY_NS + self._line.occupied_ns(len(self._frame))
        return self._frame

    def is_answered_by(self, ack: Ack) -> bool:
        """Whether an ACK answers the current step."""
        answered = (ack.acknowledged_type, ack.acknowledged_sequence)
        return self._step is not None and answered == (self._step.type_byte, self._sequence)

    def accept_step(self, now_ns: int) -> bool:
        """The device accepted this step; start the next. True when the transfer is complete."""
        self._step, self._frame, self._sequence = next(self._steps, None), b"", -1
        self.due_ns = now_ns + self._spacing_ns
        return self._step is None


class Memory:
    """The basis that an armed device holds, and the basis that is on its way to take its place.

    While the device may have changed over and has not said so, the outbox holds clicks back. One that waits when it has
    changed over is dropped: its weights are those of the basis before.
    """

    def __init__(self, basis: Basis | None, line: Line, outbox: Outbox) -> None:
        self.basis = basis
        self._line, self._outbox = line, outbox
        self._transfer: BasisTransfer | None = None

    def check(self, click: EncodedClick) -> None:
        """Raises LinkError for a click that is not made of the basis which the device holds."""
        if self.basis is None or click.basis_hash != self.basis.hash:
            raise LinkError("a click is made of another basis than this link's: configure the basis of its table")

    def replace(self, basis: Basis) -> None:
        """Start to hand another basis over."""
        self._transfer = BasisTransfer(basis, self._line, ARMED_SPACING_NS)

    def end_transfer(self) -> None:
        """Give an unfinished transfer up; the basis that is held stays."""
        self._transfer, self._outbox.holds_clicks = None, False

    @property
    def due_ns(self) -> int | None:
        """When `next_frame` has one, perhaps in the past; None while nothing is on its way."""
        return None if self._transfer is None else self._transfer.due_ns

    def next_frame(self, now_ns: int) -> bytes:
        """The next step of the transfer, where it is due; empty otherwise."""
        if self._transfer is None:
            return b""
        frame = self._transfer.next_frame(now_ns)
        self._outbox.holds_clicks = self._transfer.is_committing
        return frame

    def is_answered_by(self, ack: Ack) -> bool:
        """Whether an ACK answers the current step of the transfer."""
        return self._transfer is not None and self._transfer.is_answered_by(ack)

    def acknowledged(self, result: Result, now_ns: int) -> BasisReplaced | BasisRefused | None:
        """Take the answer to the current step: start the next, or end the transfer."""
        transfer = self._transfer
        if transfer is None or (result is Result.OK and not transfer.accept_step(now_ns)):
            return None
        self.end_transfer()
        if result is not Result.OK:
            return BasisRefused(result)
        self.basis = transfer.basis
        self._outbox.drop_click()
        return BasisReplaced()
