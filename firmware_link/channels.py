"""Drive bytes of a SET to drive events: clamps, held frequencies and phase writes."""

import math
import struct
from dataclasses import dataclass

from firmware_link.drive_log import Cause, ChannelTarget, DriveEvent
from firmware_link.messages import FULL_SCALE_WORD, WORDS_PER_TURN


@dataclass
class _Channel:
    """One actuator's oscillator, in words; `written` is its last phase write, None once its frequency has moved."""

    frequency: int
    amplitude: int = 0
    written: "tuple[int, int, int] | None" = None


class Channels:
    """The targets of all actuators.

    A channel with amplitude 0 keeps its frequency, so that it fades out as it sounded. A phase write sets all sounding
    channels at one instant; when their frequencies and phases run already as one earlier write set them, it changes
    nothing. So every renewal of a drive may carry the write, and the loss of a frame loses no phase.
    """

    def __init__(
        self,
        number_of_actuators: int,
        frequency_resolution_hz: float,
        frequency_minimum: int,
        frequency_maximum: int,
    ) -> None:
        self._resolution_hz = frequency_resolution_hz
        self._range = (frequency_minimum, frequency_maximum)
        self._channels = [_Channel(frequency_minimum) for _ in range(number_of_actuators)]
        self._amplitude_limits = [0] * number_of_actuators
        self._slew_per_s = 1.0
        self._writes = 0

    @property
    def is_driving(self) -> bool:
        """Whether any target is above zero."""
        return any(channel.amplitude for channel in self._channels)

    def limit(self, amplitude_limits: tuple[int, ...], slew_per_s: float) -> None:
        """Limits for the drives to come, amplitudes as words."""
        self._amplitude_limits = list(amplitude_limits)
        self._slew_per_s = slew_per_s

    def apply(self, drive: bytes, writes_phase: bool, now_us: int, sequence: int) -> DriveEvent | None:
        """Take the drive of a SET; None where nothing changes."""
        wanted = self._clamped(drive)
        writes_now = writes_phase and not self._runs_already(wanted)
        before = [(channel.frequency, channel.amplitude) for channel in self._channels]
        self._writes += writes_now
        for channel, (frequency, amplitude, phase) in zip(self._channels, wanted, strict=True):
            channel.amplitude = amplitude
            if not amplitude:
                continue
            if writes_now:
                channel.written = (frequency, phase, self._writes)
            elif frequency != channel.frequency:
                channel.written = None
            channel.frequency = frequency
        if not writes_now and before == [(channel.frequency, channel.amplitude) for channel in self._channels]:
            return None
        return self._event(now_us, Cause.SET, sequence, writes_now)

    def silence(self, now_us: int, cause: Cause) -> DriveEvent:
        """Every target to zero."""
        for channel in self._channels:
            channel.amplitude = 0
        return self._event(now_us, cause, None, writes_phase=False)

    def _clamped(self, drive: bytes) -> list[tuple[int, int, int]]:
        lowest, highest = self._range
        return [
            (min(max(frequency, lowest), highest), min(amplitude, limit), phase)
            for (frequency, amplitude, phase), limit in zip(
                struct.iter_unpack("<HHH", drive), self._amplitude_limits, strict=True
            )
        ]

    def _runs_already(self, wanted: list[tuple[int, int, int]]) -> bool:
        sounding = [
            (channel.written, (frequency, phase))
            for channel, (frequency, amplitude, phase) in zip(self._channels, wanted, strict=True)
            if amplitude
        ]
        if any(written is None or written[:2] != words for written, words in sounding):
            return False
        return len({written[2] for written, _ in sounding if written}) <= 1

    def _event(self, now_us: int, cause: Cause, sequence: int | None, writes_phase: bool) -> DriveEvent:
        targets = tuple(
            ChannelTarget(
                frequency_hz=channel.frequency * self._resolution_hz,
                amplitude=channel.amplitude / FULL_SCALE_WORD,
                phase_rad=(
                    math.tau * channel.written[1] / WORDS_PER_TURN
                    if writes_phase and channel.amplitude and channel.written
                    else None
                ),
            )
            for channel in self._channels
        )
        return DriveEvent(now_us, cause, sequence, self._slew_per_s, targets)
