"""Oscillator targets of an emulated device: clamps, held frequencies and phase writes."""

import math
import struct
from dataclasses import dataclass

from firmware_link.emulator.device_state import DeviceConfiguration
from firmware_link.emulator.drive_log import Cause, ChannelTarget, DriveEvent, PlayedWaveform
from firmware_link.protocol.messages import FULL_SCALE_WORD, WORDS_PER_TURN


@dataclass
class _Channel:
    """One actuator's oscillator, in words; `written` is the last phase write, None once its frequency has moved."""

    frequency: int
    amplitude: int = 0
    written: "tuple[int, int, int] | None" = None


class Channels:
    """The targets of all actuators.

    A channel with amplitude 0 keeps its frequency, so that it fades out as it sounded. A phase write sets all sounding
    channels at one instant; when their frequencies and phases run already as one earlier write set them, it changes
    nothing. So every renewal of a drive may carry the write, and the loss of a frame loses no phase.
    """

    def __init__(self, configuration: DeviceConfiguration) -> None:
        number_of_actuators, lowest = configuration.number_of_actuators, configuration.frequency_minimum
        self.slew_per_s = 1  # the slew in full scale a second, as it was armed when the last drive came
        self._resolution_hz = configuration.frequency_resolution_uhz * 1e-6
        self._range = (lowest, configuration.frequency_maximum)
        self._channels = [_Channel(lowest) for _ in range(number_of_actuators)]
        self._amplitude_limits: tuple[int, ...] = (0,) * number_of_actuators
        self._armed_limits = (self._amplitude_limits, self.slew_per_s)
        self._writes = 0

    @property
    def is_driving(self) -> bool:
        """Whether any amplitude is set above zero."""
        return any(channel.amplitude for channel in self._channels)

    def limit(self, amplitude_limits: tuple[int, ...], slew_per_s: int) -> None:
        """Set the limits that hold from the next SET or PLAY on; amplitudes are words."""
        self._armed_limits = (amplitude_limits, slew_per_s)

    def take_limits(self) -> tuple[int, ...]:
        """Put the limits of the last ARM into force; the amplitude limits."""
        self._amplitude_limits, self.slew_per_s = self._armed_limits
        return self._amplitude_limits

    def apply(
        self, drive: bytes, writes_phase: bool, now_us: int, sequence: int, *, takes_over: bool, is_first: bool
    ) -> DriveEvent | None:
        """Take the drive of a SET; None where nothing changes, unless it takes over from a waveform.

        New limits are a change: they bound what still fades, but for the first drive, before which nothing sounded.
        """
        limits = self._amplitude_limits, self.slew_per_s
        self.take_limits()
        is_limited_anew = not is_first and limits != (self._amplitude_limits, self.slew_per_s)
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
        is_unchanged = before == [(channel.frequency, channel.amplitude) for channel in self._channels]
        if is_unchanged and not writes_now and not takes_over and not is_limited_anew:
            return None
        return self._event(now_us, Cause.SET, sequence, writes_phase=writes_now)

    def play(self, waveform: PlayedWaveform, now_us: int, sequence: int) -> DriveEvent:
        """Set every amplitude to zero and start a waveform, after `take_limits`."""
        self._mute()
        return self._event(now_us, Cause.PLAY, sequence, waveform=waveform)

    def silence(self, now_us: int, cause: Cause) -> DriveEvent:
        """Set every amplitude to zero."""
        self._mute()
        return self._event(now_us, cause, None)

    def _mute(self) -> None:
        for channel in self._channels:
            channel.amplitude = 0

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

    def _event(
        self,
        now_us: int,
        cause: Cause,
        sequence: int | None,
        *,
        writes_phase: bool = False,
        waveform: PlayedWaveform | None = None,
    ) -> DriveEvent:
        targets = tuple(
            ChannelTarget(
                frequency_hz=channel.frequency * self._resolution_hz,
                amplitude=min(channel.amplitude, limit) / FULL_SCALE_WORD,
                phase_rad=(
                    math.tau * channel.written[1] / WORDS_PER_TURN
                    if writes_phase and channel.amplitude and channel.written
                    else None
                ),
                limit=limit / FULL_SCALE_WORD,
            )
            for channel, limit in zip(self._channels, self._amplitude_limits, strict=True)
        )
        return DriveEvent(now_us, cause, sequence, float(self.slew_per_s), targets, waveform)
