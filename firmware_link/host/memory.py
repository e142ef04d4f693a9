"""The device's memory for waveforms as the host sees it: the bank that it holds, and the transfer of another one."""

from collections.abc import Iterator

from firmware_link.host.line import Line
from firmware_link.host.link_values import BankRefused, BankReplaced
from firmware_link.host.outbox import Outbox, WantedWaveform
from firmware_link.protocol.bank import Bank, transfer_messages
from firmware_link.protocol.errors import LinkError
from firmware_link.protocol.framing import FrameEncoder
from firmware_link.protocol.messages import Ack, BankBegin, BankChunk, BankCommit, Result, encode_amplitude

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


class Memory:
    """The bank that an armed device holds, and the bank that is on its way to take its place.

    While the device may have changed over and has not said so, the outbox holds waveforms back.
    """

    def __init__(self, bank: Bank | None, encoder: FrameEncoder, line: Line, outbox: Outbox) -> None:
        self.bank = bank
        self._encoder, self._line, self._outbox = encoder, line, outbox
        self._transfer: BankTransfer | None = None
        self._commands: dict[tuple[int, float], WantedWaveform] = {}
        """Commands that were asked for, by their arguments: touches ask for the same few again and again."""

    def command(self, waveform: int, amplitude: float) -> WantedWaveform:
        """Command for a waveform; raises LinkError for an index beyond the bank, or an amplitude outside 0 … 1."""
        command = self._commands.get((waveform, amplitude))
        if command is None:
            if self.bank is None or not 0 <= waveform < len(self.bank.waveforms):
                raise LinkError(f"waveform {waveform} is not in the bank of this link: configure a bank that has it")
            command = WantedWaveform(waveform, encode_amplitude(amplitude), self.bank.length_us(waveform))
            self._commands[waveform, amplitude] = command
        return command

    def replace(self, bank: Bank, data: bytes) -> None:
        """Start to hand another bank over; `data` are its bytes for the device."""
        self._transfer = BankTransfer(bank, data, self._encoder, self._line, ARMED_SPACING_NS)

    def end_transfer(self) -> None:
        """Give an unfinished transfer up; the bank that is held stays."""
        self._transfer, self._outbox.holds_waveforms = None, False

    @property
    def due_ns(self) -> int | None:
        """When `next_frame` has one, perhaps in the past; None while nothing is on its way."""
        return None if self._transfer is None else self._transfer.due_ns

    def next_frame(self, now_ns: int) -> bytes:
        """The next step of the transfer, where it is due; empty otherwise."""
        if self._transfer is None:
            return b""
        frame = self._transfer.next_frame(now_ns)
        self._outbox.holds_waveforms = self._transfer.is_committing
        return frame

    def is_answered_by(self, ack: Ack) -> bool:
        """Whether an ACK answers the current step of the transfer."""
        return self._transfer is not None and self._transfer.is_answered_by(ack)

    def acknowledged(self, result: Result, now_ns: int) -> BankReplaced | BankRefused | None:
        """Take the answer to the current step: start the next, or end the transfer."""
        transfer = self._transfer
        if transfer is None or (result is Result.OK and not transfer.advance(now_ns)):
            return None
        self.end_transfer()
        if result is not Result.OK:
            return BankRefused(result)
        self.bank, self._commands = transfer.bank, {}
        return BankReplaced()
