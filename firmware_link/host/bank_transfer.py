"""A bank on its way to an armed device: a step at a time, each again until it is acknowledged."""

from collections.abc import Callable, Iterator

from firmware_link.protocol.bank import Bank, transfer_steps
from firmware_link.protocol.layout import Message
from firmware_link.protocol.messages import Ack, BankBegin, BankChunk, BankCommit

RETRY_NS = 100_000_000
# Each step takes a sequence number: a command after many of them must not seem older than the one before.
SPACING_NS = 2_000_000


class BankTransfer:
    """Steps of one transfer. `number` makes a frame of a message and tells its sequence."""

    def __init__(self, bank: Bank, data: bytes, number: Callable[[Message], tuple[bytes, int]]) -> None:
        self.bank = bank
        self.due_ns = 0
        self._steps: Iterator[BankBegin | BankChunk | BankCommit] = transfer_steps(data)
        self._number = number
        self._step: BankBegin | BankChunk | BankCommit | None = next(self._steps)
        self._frame, self._sequence = b"", -1

    @property
    def is_committing(self) -> bool:
        """Whether the device may have changed over, and has not said so."""
        return isinstance(self._step, BankCommit) and bool(self._frame)

    def next_frame(self, now_ns: int) -> bytes:
        """The step that waits for its answer, where it is due."""
        if now_ns < self.due_ns or self._step is None:
            return b""
        if not self._frame:
            self._frame, self._sequence = self._number(self._step)
        self.due_ns = now_ns + RETRY_NS
        return self._frame

    def answers(self, ack: Ack) -> bool:
        """Whether it is the answer to the step that waits."""
        return self._step is not None and (ack.acknowledged_type, ack.acknowledged_sequence) == (
            self._step.type_byte,
            self._sequence,
        )

    def go_on(self, now_ns: int) -> bool:
        """The step was taken; whether it was the last."""
        self._step, self._frame, self._sequence = next(self._steps, None), b"", -1
        self.due_ns = now_ns + SPACING_NS
        return self._step is None
