"""Synthesis: the log of drives to the base displacement of each actuator, as the firmware makes it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from firmware_link.emulator.drive_log import ChannelTarget, DriveEvent, PlayedWaveform
from firmware_link.protocol.basis import SAMPLE_FULL_SCALE

S_PER_US = 1e-6
US_PER_S = 1e6


def synthesise(
    log: Sequence[DriveEvent], start_us: float, stop_us: float, sample_rate_hz: float
) -> NDArray[np.float64]:
    """Base displacements (time, actuator), as fractions of full scale, from device time `start_us` up to `stop_us`.

    Samples lie on the grid n / sample_rate_hz from device time 0, so chunks that touch join without a seam and any
    chunking gives the same values. An empty log has no actuators.

    Frequency changes keep the phase. Amplitude moves in a straight line at the event's slew. A phase written while a
    channel sounds does not click: the channel first ramps to zero as it was, takes over the new oscillator there, and
    ramps up. The new oscillator runs from the event's time, so that all channels written by one event are
    sin(2π f (t - t_event) + phase), whenever each of them has faded. A new target during that fade applies after it.

    A waveform is added from its event on, interpolated linearly between its samples; from the next event on its
    amplitude falls at the slew of that one. The sum is clamped.
    """
    first, stop = (math.ceil(time_us * sample_rate_hz / US_PER_S) for time_us in (start_us, stop_us))
    times_us = np.arange(first, stop, dtype=np.float64) * (US_PER_S / sample_rate_hz)
    number_of_actuators = len(log[0].channels) if log else 0
    displacements = np.empty((times_us.size, number_of_actuators))
    for actuator in range(number_of_actuators):
        displacements[:, actuator] = _evaluate(_segments(log, actuator), times_us)
    for event, following in zip(log, [*log[1:], None], strict=False):
        if event.waveform is not None:
            _add_waveform(displacements, times_us, event.waveform, event.device_time_us, following)
    return _clamp(displacements, times_us, log)


def _add_waveform(
    displacements: NDArray[np.float64],
    times_us: NDArray[np.float64],
    played: PlayedWaveform,
    start_us: int,
    following: DriveEvent | None,
) -> None:
    samples = played.samples / SAMPLE_FULL_SCALE
    length_us = (len(samples) - 1) * US_PER_S / played.sample_rate_hz
    first, stop = np.searchsorted(times_us, [start_us, start_us + length_us])
    played_us = times_us[first:stop] - start_us
    amplitude = np.full(played_us.size, played.amplitude)
    if following is not None:
        faded_us = np.maximum(times_us[first:stop] - following.device_time_us, 0.0)
        amplitude = np.maximum(amplitude - following.slew_per_s * faded_us / US_PER_S, 0.0)
    index = np.arange(len(samples))
    for actuator in range(displacements.shape[1]):
        moved = np.interp(played_us * S_PER_US * played.sample_rate_hz, index, samples[:, actuator])
        displacements[first:stop, actuator] += amplitude * moved


def _clamp(
    displacements: NDArray[np.float64], times_us: NDArray[np.float64], log: Sequence[DriveEvent]
) -> NDArray[np.float64]:
    if not log:
        return displacements
    limits = np.array([[channel.limit for channel in event.channels] for event in log])
    index = np.searchsorted([event.device_time_us for event in log], times_us, side="right") - 1
    bound = limits[np.maximum(index, 0)]
    result: NDArray[np.float64] = np.clip(displacements, -bound, bound)
    return result


@dataclass(frozen=True)
class _Segment:
    """From `start_us` on: amplitude + slope·t times the sine of turns + frequency·t, t since then."""

    start_us: float
    amplitude: float
    slope_per_us: float
    turns: float
    frequency_hz: float


@dataclass
class _Oscillator:
    """A sine's frequency, and its phase in turns at a time."""

    frequency_hz: float
    turns: float
    at_us: float

    def advance(self, time_us: float) -> None:
        self.turns = (self.turns + self.frequency_hz * (time_us - self.at_us) * S_PER_US) % 1.0
        self.at_us = time_us


class _Channel:
    """One actuator's synthesis, event by event; collects segments."""

    def __init__(self) -> None:
        self.segments: list[_Segment] = []
        self._oscillator = _Oscillator(0.0, 0.0, 0.0)
        self._next_oscillator: _Oscillator | None = None
        self._amplitude = 0.0
        self._target = 0.0
        self._slew_per_us = 1.0

    def apply(self, time_us: float, target: ChannelTarget, slew_per_s: float) -> None:
        """Apply an event; `run_to` its time must come first."""
        self._slew_per_us = slew_per_s * S_PER_US
        self._target = target.amplitude
        if target.phase_rad is not None:
            self._next_oscillator = _Oscillator(target.frequency_hz, target.phase_rad / math.tau, time_us)
        else:
            changed = self._next_oscillator or self._oscillator
            changed.advance(time_us)
            changed.frequency_hz = target.frequency_hz

    def run_to(self, stop_us: float) -> None:
        """Collect the segments up to a time; infinity for all that remain."""
        if self._next_oscillator is not None and self._ramp_to(0.0, stop_us):
            self._next_oscillator.advance(self._oscillator.at_us)
            self._oscillator, self._next_oscillator = self._next_oscillator, None
        if self._next_oscillator is None and self._ramp_to(self._target, stop_us):
            self._leave(0.0)
            if stop_us < math.inf:
                self._oscillator.advance(stop_us)

    def _ramp_to(self, goal: float, stop_us: float) -> bool:
        """Ramp until the goal or the time, whichever is first; returns whether the goal was reached."""
        distance = goal - self._amplitude
        if distance == 0:
            return True
        slope = math.copysign(self._slew_per_us, distance)
        self._leave(slope)
        end_us = self._oscillator.at_us + distance / slope
        is_reached = end_us <= stop_us
        self._amplitude = goal if is_reached else self._amplitude + slope * (stop_us - self._oscillator.at_us)
        self._oscillator.advance(min(end_us, stop_us))
        return is_reached

    def _leave(self, slope_per_us: float) -> None:
        oscillator = self._oscillator
        self.segments.append(
            _Segment(oscillator.at_us, self._amplitude, slope_per_us, oscillator.turns, oscillator.frequency_hz)
        )


def _segments(log: Sequence[DriveEvent], actuator: int) -> list[_Segment]:
    channel = _Channel()
    for event in log:
        channel.run_to(event.device_time_us)
        channel.apply(event.device_time_us, event.channels[actuator], event.slew_per_s)
    channel.run_to(math.inf)
    return channel.segments


def _evaluate(segments: list[_Segment], times_us: NDArray[np.float64]) -> NDArray[np.float64]:
    starts_us, amplitudes, slopes, turns, frequencies = np.array(
        [(s.start_us, s.amplitude, s.slope_per_us, s.turns, s.frequency_hz) for s in segments]
    ).T
    index = np.maximum(np.searchsorted(starts_us, times_us, side="right") - 1, 0)
    elapsed_us = times_us - starts_us[index]
    phase_turns = turns[index] + frequencies[index] * (elapsed_us * S_PER_US)
    result: NDArray[np.float64] = (amplitudes[index] + slopes[index] * elapsed_us) * np.sin(math.tau * phase_turns)
    return result
