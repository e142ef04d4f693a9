"""The field `drive` of a SET: frequency, amplitude and phase of each actuator, to the words that travel and back."""

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass

from firmware_link.protocol.link_errors import MessageError
from firmware_link.protocol.messages import FULL_SCALE_WORD, WORDS_PER_TURN


@dataclass(frozen=True)
class ChannelDrive:
    """One actuator's drive: base displacement `amplitude · sin(2π frequency t + phase)`, in fractions of full scale."""

    frequency_hz: float
    amplitude: float
    phase_rad: float = 0.0


_DRIVE_WORDS = struct.Struct("<HHH")
DRIVE_SIZE = _DRIVE_WORDS.size


def encode_drive(channels: Sequence[ChannelDrive], frequency_resolution_hz: float) -> bytes:
    """Drive part of a SET, one channel an actuator; raises MessageError for a value out of its range, never wraps it.

    A phase is an angle: any finite one is reduced to one turn.
    """
    return b"".join(
        _DRIVE_WORDS.pack(
            _nearest_word("frequency_hz", channel.frequency_hz, FULL_SCALE_WORD * frequency_resolution_hz),
            encode_amplitude(channel.amplitude),
            _phase_word(channel.phase_rad),
        )
        for channel in channels
    )


def decode_drive(drive: bytes, frequency_resolution_hz: float) -> tuple[ChannelDrive, ...]:
    """Channels of the drive part of a SET, as near as its words tell."""
    return tuple(
        ChannelDrive(
            frequency * frequency_resolution_hz, amplitude / FULL_SCALE_WORD, math.tau * phase / WORDS_PER_TURN
        )
        for frequency, amplitude, phase in _DRIVE_WORDS.iter_unpack(drive)
    )


def encode_amplitude(amplitude: float) -> int:
    """Word of a fraction of full scale; raises MessageError outside 0 … 1."""
    return _nearest_word("amplitude", amplitude, 1.0)


def _nearest_word(name: str, value: float, full_scale: float) -> int:
    if not 0 <= value <= full_scale:
        raise MessageError(f"{name} is {value!r}; expected 0 to {full_scale:g}")
    return round(value / full_scale * FULL_SCALE_WORD)


def _phase_word(phase_rad: float) -> int:
    if not math.isfinite(phase_rad):
        raise MessageError(f"phase_rad is {phase_rad!r}; expected a finite angle")
    return round(math.remainder(phase_rad, math.tau) / math.tau * WORDS_PER_TURN) % WORDS_PER_TURN
