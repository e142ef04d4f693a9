"""Bank of waveforms to the bytes that a device holds and back, and the steps that transfer them."""

import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from firmware_link.protocol.errors import MessageError
from firmware_link.protocol.messages import BANK_CHUNK_SIZE, BankBegin, BankChunk, BankCommit

US_PER_S = 1_000_000
SAMPLE_FULL_SCALE = 32_767
SHORTEST_WAVEFORM = 2
SAMPLE_SIZE = 2
_HEAD = struct.Struct("<HH")
_HEAD_WORD_SIZE = 2
_LONGEST_WAVEFORM = 0xFFFF
# A hash of 0 means that no bank is held.
_HASH_INSTEAD_OF_0 = 1

Samples = NDArray[np.int16]


@dataclass(frozen=True, eq=False)
class Bank:
    """Waveforms (sample, actuator) at one rate; SAMPLE_FULL_SCALE is full scale."""

    sample_rate_hz: int
    waveforms: tuple[Samples, ...]

    def length_us(self, index: int) -> int:
        """Duration of a waveform, rounded up."""
        return -(-(len(self.waveforms[index]) - 1) * US_PER_S // self.sample_rate_hz)


def make_bank(sample_rate_hz: int, waveforms: Sequence[NDArray[np.float64]]) -> Bank:
    """Bank of displacements (sample, actuator) in fractions of full scale; raises MessageError beyond -1 to 1."""
    greatest = max((float(np.abs(waveform).max(initial=0.0)) for waveform in waveforms), default=0.0)
    if not greatest <= 1.0:
        raise MessageError(f"a waveform reaches {greatest:g} of full scale; expected at most 1")
    return Bank(sample_rate_hz, tuple(np.rint(SAMPLE_FULL_SCALE * w).astype(np.int16) for w in waveforms))


def bank_size(number_of_actuators: int, lengths: Sequence[int]) -> int:
    """Size of a bank in bytes, of waveforms with these numbers of samples."""
    return _HEAD.size + sum(_HEAD_WORD_SIZE + SAMPLE_SIZE * number_of_actuators * length for length in lengths)


def encode_bank(bank: Bank, number_of_actuators: int) -> bytes:
    """Bytes of a bank for a device, whose further actuators are silent; raises MessageError for an invalid bank."""
    lengths = [len(waveform) for waveform in bank.waveforms]
    if not 1 <= bank.sample_rate_hz <= 0xFFFF:
        raise MessageError(f"the sample rate of a bank is {bank.sample_rate_hz} Hz; expected 1 to 65535")
    if not 1 <= len(lengths) <= 0xFFFF:
        raise MessageError(f"a bank has {len(lengths)} waveforms; expected 1 to 65535")
    for index, waveform in enumerate(bank.waveforms):
        _check_waveform(index, waveform)
        if waveform.shape[1] > number_of_actuators:
            raise MessageError(f"waveform {index} is for {waveform.shape[1]} actuators, not {number_of_actuators}")
    head = _HEAD.pack(bank.sample_rate_hz, len(lengths)) + struct.pack(f"<{len(lengths)}H", *lengths)
    spare = ((0, 0), (0, number_of_actuators))
    return head + b"".join(
        np.pad(waveform, spare)[:, :number_of_actuators].astype("<i2").tobytes() for waveform in bank.waveforms
    )


def decode_bank(data: bytes, number_of_actuators: int) -> Bank:
    """Bank of its bytes; raises MessageError for bytes that are not a bank for this number of actuators."""
    try:
        sample_rate_hz, number = _HEAD.unpack_from(data)
        lengths = struct.unpack_from(f"<{number}H", data, _HEAD.size)
    except struct.error as error:
        raise MessageError(f"a bank of {len(data)} bytes ends within its head: {error}") from error
    start = _HEAD.size + _HEAD_WORD_SIZE * number
    samples = np.frombuffer(data[start : start + (len(data) - start) // 2 * 2], "<i2").astype(np.int16)
    expected = start + 2 * number_of_actuators * sum(lengths)
    if not sample_rate_hz or not lengths or len(data) != expected:
        raise MessageError(
            f"a bank of {number} waveforms at {sample_rate_hz} Hz has {len(data)} bytes; expected {expected}"
        )
    edges = np.cumsum(lengths)[:-1]
    waveforms = tuple(np.split(samples.reshape(-1, number_of_actuators), edges))
    for index, waveform in enumerate(waveforms):
        _check_waveform(index, waveform)
    return Bank(sample_rate_hz, waveforms)


def hash_of_bank(data: bytes) -> int:
    """Hash that names the bytes of a bank; never 0."""
    return zlib.crc32(data) or _HASH_INSTEAD_OF_0


def transfer_messages(data: bytes) -> Iterator[BankBegin | BankChunk | BankCommit]:
    """Messages that transfer a bank, in order; each must be acknowledged before the next."""
    bank_hash = hash_of_bank(data)
    yield BankBegin(bank_hash, len(data))
    for offset in range(0, len(data), BANK_CHUNK_SIZE):
        yield BankChunk(offset, data[offset : offset + BANK_CHUNK_SIZE].ljust(BANK_CHUNK_SIZE, b"\0"))
    yield BankCommit(bank_hash)


def _check_waveform(index: int, waveform: Samples) -> None:
    if not SHORTEST_WAVEFORM <= len(waveform) <= _LONGEST_WAVEFORM:
        raise MessageError(
            f"waveform {index} has {len(waveform)} samples; expected {SHORTEST_WAVEFORM} to {_LONGEST_WAVEFORM}"
        )
    if waveform[0].any() or waveform[-1].any():
        raise MessageError(f"waveform {index} does not begin and end at 0: let its first and last sample be 0")
