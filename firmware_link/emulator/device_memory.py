"""BASIS_* of the wire: the steps that transfer a basis of clicks, and the memory of an emulated device for it."""

from firmware_link.emulator.device_reports import Reports
from firmware_link.emulator.device_state import Device
from firmware_link.emulator.drive_log import Outcome
from firmware_link.protocol import messages
from firmware_link.protocol.basis import Basis, decode_basis, hash_of_basis
from firmware_link.protocol.link_errors import MessageError

US_PER_MS = 1_000


class Memory:
    """Memory for the basis that is held and, where it fits, the next; a copied step changes nothing (core/basis.c)."""

    def __init__(self, device: Device, reports: Reports) -> None:
        self.basis: Basis | None = None
        self.held_hash = 0
        self._device, self._configuration, self._reports = device, device.configuration, reports
        self._held_at = self._held_size = self._transfer_at = 0
        self._transfer: messages.BasisBegin | None = None
        self._taken = bytearray()

    def keep(self, message: messages.BasisBegin | messages.BasisChunk | messages.BasisCommit, sequence: int) -> Outcome:
        """Take one step of a transfer and acknowledge it; a new basis is told by LOG."""
        held_hash = self.held_hash
        result = (
            messages.Result.WRONG_STATE if self._device.state is messages.DeviceState.LATCHED else self._take(message)
        )
        self._reports.send_ack(message.type_byte, sequence, result)
        if self.basis is not None and self.held_hash != held_hash:
            self._reports.send_log(messages.LogLevel.INFORMATION, messages.LogCode.BASIS_TAKEN, self.held_hash)
        return Outcome.ACCEPTED if result is messages.Result.OK else Outcome.REFUSED

    def end_transfer(self) -> None:
        """Forget an unfinished transfer; the basis that is held stays."""
        self._transfer = None

    def _take(self, message: messages.BasisBegin | messages.BasisChunk | messages.BasisCommit) -> messages.Result:
        match message:
            case messages.BasisBegin():
                return self._begin(message)
            case messages.BasisChunk():
                return self._append(message)
            case messages.BasisCommit():
                return self._commit(message)

    def _begin(self, begin: messages.BasisBegin) -> messages.Result:
        """Wait for another basis; without room for both, an idle device forgets the one that is held."""
        if begin == self._transfer:
            return messages.Result.OK
        if not begin.basis_hash:
            return messages.Result.OUT_OF_RANGE
        if begin.size_bytes > self._configuration.basis_capacity_bytes:
            return messages.Result.NO_ROOM
        room_at = self._room_at(begin.size_bytes)
        if room_at is None:
            if self._device.state is not messages.DeviceState.IDLE:
                return messages.Result.NO_ROOM
            self.basis, self.held_hash, room_at = None, 0, 0
        self._transfer, self._transfer_at = begin, room_at
        self._taken.clear()
        return messages.Result.OK

    def _append(self, chunk: messages.BasisChunk) -> messages.Result:
        if self._transfer is None:
            return messages.Result.WRONG_STATE
        if chunk.offset_bytes < len(self._taken) and chunk.offset_bytes % messages.BASIS_CHUNK_SIZE == 0:
            return messages.Result.OK
        if chunk.offset_bytes != len(self._taken) or chunk.offset_bytes >= self._transfer.size_bytes:
            return messages.Result.OUT_OF_RANGE
        self._taken += chunk.data[: self._transfer.size_bytes - chunk.offset_bytes]
        return messages.Result.OK

    def _commit(self, commit: messages.BasisCommit) -> messages.Result:
        """Hold what was transferred, if it is what was announced."""
        transfer = self._transfer
        if transfer is None:
            return messages.Result.OK if commit.basis_hash == self.held_hash != 0 else messages.Result.WRONG_STATE
        self.end_transfer()
        data = bytes(self._taken)
        if len(data) != transfer.size_bytes or not commit.basis_hash == transfer.basis_hash == hash_of_basis(data):
            return messages.Result.WRONG_HASH
        try:
            basis = decode_basis(data, self._configuration.number_of_actuators)
        except MessageError:
            return messages.Result.OUT_OF_RANGE
        if max(map(basis.length_us, range(len(basis.sets)))) > self._configuration.longest_waveform_ms * US_PER_MS:
            return messages.Result.OUT_OF_RANGE
        self.basis, self.held_hash = basis, commit.basis_hash
        self._held_at, self._held_size = self._transfer_at, transfer.size_bytes
        return messages.Result.OK

    def _room_at(self, size_bytes: int) -> int | None:
        """Where a basis goes in the memory, beside the one that is held: before it or else behind."""
        if not self.held_hash or size_bytes <= self._held_at:
            return 0
        behind = self._held_at + self._held_size
        return behind if size_bytes <= self._configuration.basis_capacity_bytes - behind else None
