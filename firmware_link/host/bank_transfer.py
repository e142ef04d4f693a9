"""Transfer of a bank to a device: one step at a time, each repeated until the device acknowledges it."""

from collections.abc import Iterator

from firmware_link.host.line import Line
from firmware_link.protocol.bank import Bank, transfer_messages
from firmware_link.protocol.framing import FrameEncoder
from firmware_link.protocol.messages import Ack, BankBegin, BankChunk, BankCommit

RETRY_NS = 100_000_000
# Each step takes a sequence number. While the device is armed, too many steps within a lease would make a command that
# follows them seem older than the command before them.
ARMED_SPACING_NS = 2_000_000


class BankTransfer:
    """The steps BANK_BEGIN, BANK_CHUNK … and BANK_COMMIT of one bank, `spacing_ns` apart.

    A repeated step is the same frame under the same sequence, so that an answer names the step that it answers, and
    the device recognises a copy. `data` are the bytes of `bank` for the device.
    """

    def __init__(self, bank: Bank, data: bytes, encoder: FrameEncoder, line: Line, spacing_ns: int = 0) -> None:
        self.bank = bank
        self.due_ns = 0
        """The next frame is due at this time."""
        self._encoder, self._line, self._spacing_ns = encoder, line, spacing_ns
        self._steps: Iterator[BankBegin | BankChunk | BankCommit] = transfer_messages(data)
        self._step: BankBegin | BankChunk | BankCommit | None = next(self._steps)
        self._frame, self._sequence = b"", -1

    @property
    def is_committing(self) -> bool:
        """Whether BANK_COMMIT was sent and not yet answered: which of the two banks the device plays is unknown."""
        return isinstance(self._step, BankCommit) and bool(self._frame)

    def next_frame(self, now_ns: int) -> bytes:
        """Frame of the current step, where it is due; empty otherwise."""
        if now_ns < self.due_ns or self._step is None:
            return b""
        if not self._frame:
            self._frame = self._encoder.encode(self._step)
            self._sequence = self._encoder.sequence
        self.due_ns = now_ns + RETRY_NS + self._line.occupied_ns(len(self._frame))
        return self._frame

    def is_answered_by(self, ack: Ack) -> bool:
        """Whether an ACK answers the current step."""
        answered = (ack.acknowledged_type, ack.acknowledged_sequence)
        return self._step is not None and answered == (self._step.type_byte, self._sequence)

    def advance(self, now_ns: int) -> bool:
        """The device accepted this step; start the next. True when the transfer is complete."""
        self._step, self._frame, self._sequence = next(self._steps, None), b"", -1
        self.due_ns = now_ns + self._spacing_ns
        return self._step is None
