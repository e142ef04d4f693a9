"""Tones: targets of the actuators to oscillators that run on, with amplitudes in straight lines.

Theory of operation
-------------------
A channel has two oscillators: the one that it plays, and, during a crossfade, the one that it played before. The
amplitudes of all channels go along one w from 0 to 1, in the shortest time in which no channel's amplitudes together
move faster than the slew. So a change of drive is (1 - w) of the old and w of the new one, and what both leave quiet
stays quiet.

Two cases differ. From silence each channel rises at the slew, and to silence each one falls at the slew, the two
amplitudes of a crossfade in proportion. A target that comes during a crossfade waits until it has ended.

The phases of an event count from its time, for all channels together. Where a channel sounds already, one angle is
added to all of them, so that of the channels that sound the loudest one to come goes on in phase: how the channels
stand to each other is kept, and drives that differ a little are displacements that differ a little.
"""

import copy
import math
from dataclasses import dataclass, field, replace

import numpy as np

from base.arrays import Array
from firmware_link.emulator.drive_log import ChannelTarget, DriveEvent
from firmware_link.protocol.messages import FULL_SCALE_WORD

S_PER_US = 1e-6
_SILENT = 0.5 / FULL_SCALE_WORD  # less is silence: half of the least amplitude that a SET can ask for
_ROUNDING_US = 1e-3  # what comes just when a crossfade ends does not wait; the end of a crossfade is a sum, and rounded
_SHORTEST_US = 1e-3  # a stretch without a length is over; dividing by less overflows after minutes


@dataclass(frozen=True)
class _Oscillator:
    """A sine's frequency, and its phase in turns at a time."""

    frequency_hz: float = 0.0
    turns: float = 0.0
    at_us: float = 0.0

    def turns_at(self, time_us: float) -> float:
        return self.turns + self.frequency_hz * (time_us - self.at_us) * S_PER_US

    def tuned(self, frequency_hz: float, time_us: float) -> "_Oscillator":
        """The oscillator with another frequency from a time on, its phase kept."""
        return _Oscillator(frequency_hz, self.turns_at(time_us) % 1.0, time_us)


@dataclass
class _Channel:
    """One actuator. From `begun_us` on, for `length_us`, `amplitude` goes to `goal` and `fading` to 0."""

    oscillator: _Oscillator = _Oscillator()
    faded: _Oscillator = _Oscillator()
    amplitude: float = 0.0
    fading: float = 0.0
    goal: float = 0.0
    begun_us: float = 0.0
    length_us: float = 0.0
    target: float = 0.0
    written: _Oscillator | None = None  # what the next transition begins to play, from the time of its event
    stretches: list[tuple[float, ...]] = field(default_factory=list)  # start in us, and what `evaluate` needs

    def amplitudes(self, time_us: float) -> tuple[float, float]:
        """Amplitudes of the oscillator that it plays, and of the one that fades."""
        if time_us >= self.end_us:
            return self.goal, 0.0
        w = (time_us - self.begun_us) / self.length_us
        return self.amplitude + (self.goal - self.amplitude) * w, self.fading * (1.0 - w)

    @property
    def end_us(self) -> float:
        """Time at which it reaches its goal."""
        return self.begun_us + self.length_us

    def take_target(self, target: ChannelTarget, time_us: float) -> None:
        """Take a target; without a phase write the frequency changes at once."""
        self.target = target.amplitude
        if target.phase_rad is not None:
            self.written = _Oscillator(target.frequency_hz, target.phase_rad / math.tau, time_us)
        elif self.written is not None:
            self.written = self.written.tuned(target.frequency_hz, time_us)
        elif target.frequency_hz != self.oscillator.frequency_hz:
            self.oscillator = self.oscillator.tuned(target.frequency_hz, time_us)
            self._leave(time_us)

    def change(self, time_us: float) -> float:
        """How far its amplitudes have to go to its target."""
        amplitude, _ = self.amplitudes(time_us)
        if self.written is not None and amplitude >= _SILENT:
            return amplitude + self.target
        return abs(self.target - amplitude)

    def begin_target(self, time_us: float, length_us: float, turns: float) -> None:
        """Go to the target; `turns` are added to a phase that was written."""
        self.amplitude, self.fading = self.amplitudes(time_us)[0], 0.0
        if self.written is not None:
            if self.amplitude >= _SILENT:
                self.faded, self.fading = self.oscillator, self.amplitude
            self.oscillator = replace(self.written, turns=self.written.turns + turns)
            self.amplitude, self.written = 0.0, None
        self.goal, self.begun_us, self.length_us = self.target, time_us, length_us
        self._leave(time_us)

    def fall(self, time_us: float, slew_per_us: float) -> None:
        """Go to silence; an oscillator that was written is kept for the next target."""
        self.amplitude, self.fading = self.amplitudes(time_us)
        self.goal, self.begun_us = 0.0, time_us
        self.length_us = (self.amplitude + self.fading) / slew_per_us
        self._leave(time_us)

    def _leave(self, time_us: float) -> None:
        new, old = self.oscillator, self.faded
        self.stretches.append(
            (
                *(time_us, self.begun_us, self.length_us, self.amplitude, self.goal, self.fading),
                *(new.frequency_hz, new.turns, new.at_us, old.frequency_hz, old.turns, old.at_us),
            )
        )


class Tones:
    """The oscillators of all actuators: `take_event` in the order of their times, then `evaluate` any time."""

    def __init__(self, number_of_actuators: int) -> None:
        self._channels = [_Channel() for _ in range(number_of_actuators)]
        self._slew_per_us = 1.0
        self._is_crossfading = self._is_waiting = False

    @property
    def size(self) -> int:
        """Number of stretches that it holds."""
        return sum(len(channel.stretches) for channel in self._channels)

    def take_event(self, event: DriveEvent) -> None:
        """Take the targets of an event."""
        time_us = event.device_time_us
        self._run_to(time_us)
        self._slew_per_us = event.slew_per_s * S_PER_US
        for channel, target in zip(self._channels, event.channels, strict=True):
            channel.take_target(target, time_us)
        if not any(channel.target for channel in self._channels):
            self._is_waiting = False
            for channel in self._channels:
                channel.fall(time_us, self._slew_per_us)
        elif self._is_crossfading:
            self._is_waiting = True
        else:
            self._begin(time_us)

    def evaluate(self, times_us: Array) -> Array:
        """Displacements (time, actuator) at times after those of the last `forget`, as if no event were to come."""
        # What waits now may begin without another event.
        ahead = self
        if self._is_waiting:
            ahead = copy.copy(self)
            ahead._channels = [replace(channel, stretches=channel.stretches.copy()) for channel in self._channels]
            ahead._run_to(math.inf)
        displacements = np.zeros((times_us.size, len(self._channels)))
        for actuator, channel in enumerate(ahead._channels):
            if channel.stretches:
                displacements[:, actuator] = _evaluate(np.array(channel.stretches).T, times_us)
        return displacements

    def forget(self, before_us: float) -> None:
        """Drop what is of no use for times from `before_us` on."""
        for channel in self._channels:
            passed = [index for index, stretch in enumerate(channel.stretches) if stretch[0] <= before_us]
            del channel.stretches[: passed[-1] if passed else 0]

    def _run_to(self, time_us: float) -> None:
        """Let a crossfade end, and begin what waits for that."""
        while self._is_crossfading:
            end_us = max(channel.end_us for channel in self._channels)
            if end_us > time_us + _ROUNDING_US:
                return
            self._is_crossfading = False
            if self._is_waiting:
                self._begin(min(end_us, time_us))

    def _begin(self, time_us: float) -> None:
        """Go to the targets: along one w, or from silence each channel for itself."""
        self._is_waiting = False
        changes = [channel.change(time_us) for channel in self._channels]
        sounding = [channel for channel in self._channels if channel.amplitudes(time_us)[0] >= _SILENT]
        crossfading = [channel for channel in sounding if channel.written is not None]
        self._is_crossfading = bool(crossfading)
        lengths_us = [change / self._slew_per_us for change in changes]
        turns = 0.0
        if sounding:
            lengths_us = [max(lengths_us)] * len(lengths_us)
        if crossfading:
            loudest = max(crossfading, key=lambda channel: channel.target)
            assert loudest.written is not None
            turns = (loudest.oscillator.turns_at(time_us) - loudest.written.turns_at(time_us)) % 1.0
        for channel, length_us in zip(self._channels, lengths_us, strict=True):
            channel.begin_target(time_us, length_us, turns)


def _evaluate(stretches: Array, times_us: Array) -> Array:
    """Displacements (time,) of one channel; 0 before its first stretch."""
    index = np.searchsorted(stretches[0], times_us, side="right") - 1
    _, begun_us, length_us, amplitude, goal, fading, *oscillators = stretches[:, np.maximum(index, 0)]
    # A stretch without a length begins at its goal.
    w = np.clip((times_us - begun_us) / np.maximum(length_us, _SHORTEST_US), 0.0, 1.0)
    w[times_us >= begun_us + length_us] = 1.0
    new, old = (
        np.sin(math.tau * (turns + frequency_hz * (times_us - at_us) * S_PER_US))
        for frequency_hz, turns, at_us in (oscillators[:3], oscillators[3:])
    )
    displacement: Array = (amplitude + (goal - amplitude) * w) * new + fading * (1.0 - w) * old
    return np.where(index < 0, 0.0, displacement)
