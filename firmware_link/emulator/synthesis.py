"""Synthesis: the log of drives to the base displacement of each actuator, as the firmware makes it."""

import itertools
import math
from collections.abc import Iterable, Sequence

import numpy as np

from base.arrays import Array
from firmware_link.emulator.drive_log import DriveEvent, PlayedWaveform
from firmware_link.emulator.tones import S_PER_US, Tones
from firmware_link.protocol.basis import SAMPLE_FULL_SCALE

US_PER_S = 1e6


class Synthesis:
    """The synthesis as it goes on: `take_events` in the order of their times, then `displacements`.

    `forget` keeps it short. Raises ValueError for a time that was forgotten.
    """

    def __init__(self) -> None:
        self._events: list[DriveEvent] = []
        self._tones = Tones(0)
        self._begin_us = -math.inf

    @property
    def size(self) -> int:
        """Number of events and of stretches of tones that it holds."""
        return len(self._events) + self._tones.size

    def take_events(self, events: Iterable[DriveEvent]) -> None:
        """Take the events that came next."""
        for event in events:
            if not self._events:
                self._tones = Tones(len(event.channels))
            self._events.append(event)
            self._tones.take_event(event)

    def displacements(self, start_us: float, stop_us: float, sample_rate_hz: float) -> Array:
        """As `synthesise`, for the events so far."""
        if start_us < self._begin_us:
            raise ValueError(f"synthesis of {start_us:g} us: all before {self._begin_us:g} us is forgotten")
        first, stop = (math.ceil(time_us * sample_rate_hz / US_PER_S) for time_us in (start_us, stop_us))
        times_us = np.arange(first, stop, dtype=np.float64) * (US_PER_S / sample_rate_hz)
        displacements = self._tones.evaluate(times_us)
        for event, following in zip(self._events, [*self._events[1:], None], strict=False):
            if event.waveform is not None:
                _add_waveform(displacements, times_us, event.waveform, event.device_time_us, following)
        return _clamp(displacements, times_us, self._events)

    def forget(self, before_us: float) -> None:
        """Drop what is of no use for times from `before_us` on."""
        self._begin_us = max(self._begin_us, before_us)
        self._tones.forget(before_us)
        over = 0
        for event, following in itertools.pairwise(self._events):
            if following.device_time_us > before_us or _end_us(event) > before_us:
                break
            over += 1
        del self._events[:over]


def synthesise(log: Sequence[DriveEvent], start_us: float, stop_us: float, sample_rate_hz: float) -> Array:
    """Base displacements (time, actuator), as fractions of full scale, from device time `start_us` up to `stop_us`.

    Samples lie on the grid n / sample_rate_hz from device time 0, so chunks that touch join without a seam and any
    chunking gives the same values. An empty log has no actuators.

    `firmware_link.emulator.tones` says how drives follow each other. A waveform is added from its event on,
    interpolated linearly between its samples; from the next event on its amplitude falls at the slew of that one. The
    sum is clamped.
    """
    synthesis = Synthesis()
    synthesis.take_events(log)
    return synthesis.displacements(start_us, stop_us, sample_rate_hz)


def _end_us(event: DriveEvent) -> float:
    """Latest time at which the waveform of an event can end."""
    if event.waveform is None:
        return -math.inf
    return event.device_time_us + _length_us(event.waveform)


def _length_us(played: PlayedWaveform) -> float:
    return (len(played.samples) - 1) * US_PER_S / played.sample_rate_hz


def _add_waveform(
    displacements: Array, times_us: Array, played: PlayedWaveform, start_us: int, following: DriveEvent | None
) -> None:
    samples = played.samples / SAMPLE_FULL_SCALE
    first, stop = np.searchsorted(times_us, [start_us, start_us + _length_us(played)])
    played_us = times_us[first:stop] - start_us
    amplitude = np.full(played_us.size, played.amplitude)
    if following is not None:
        faded_us = np.maximum(times_us[first:stop] - following.device_time_us, 0.0)
        amplitude = np.maximum(amplitude - following.slew_per_s * faded_us / US_PER_S, 0.0)
    index = np.arange(len(samples))
    for actuator in range(displacements.shape[1]):
        moved = np.interp(played_us * S_PER_US * played.sample_rate_hz, index, samples[:, actuator])
        displacements[first:stop, actuator] += amplitude * moved


def _clamp(displacements: Array, times_us: Array, log: Sequence[DriveEvent]) -> Array:
    if not log:
        return displacements
    limits = np.array([[channel.limit for channel in event.channels] for event in log])
    index = np.searchsorted([event.device_time_us for event in log], times_us, side="right") - 1
    bound = limits[np.maximum(index, 0)]
    result: Array = np.clip(displacements, -bound, bound)
    return result
