"""Samples of a sensor in windows of a wanted length, the drive kept alive while they come."""

import numpy as np

from base.arrays import Array
from tactable.measure.driven_device import DrivenDevice
from tactable.measure.sensor import Sensor, SensorError

PATIENCE_NS = 3_000_000_000  # a converter that says nothing for longer has stopped
_NS_PER_S = 1_000_000_000


class LostWindowError(SensorError):
    """A channel lost all samples of a window, as after a stall of the host; the next window may be whole."""


class Recorder:
    """Takes windows of samples while a device is driven. Raises SensorError without any, LinkError as its `wait`."""

    def __init__(self, driven: DrivenDevice, sensor: Sensor) -> None:
        self._driven, self._sensor = driven, sensor
        self._values = [np.empty((0, len(sensor.form.channels)))]
        self._size = 0
        self._arrived_ns = 0

    def drop(self) -> None:
        """Forget the samples that have come so far."""
        while self._sensor.read() is not None:
            pass
        self._values, self._size = [self._values[0][:0]], 0

    def follow(self, until_ns: int) -> None:
        """Take in what comes until this time, while the drive changes."""
        while self._driven.clock.now_ns() < until_ns:
            if self._driven.wait(until_ns, (self._sensor.fileno(),)):
                self._take_block()

    def take_window(self, seconds: float) -> Array:
        """The next window (sample, channel), without a gap. Raises LostWindowError where a channel lost all of it."""
        count = round(seconds * self._sensor.form.sample_rate_hz)
        clock = self._driven.clock
        while self._size < count:
            is_there = self._driven.wait(clock.now_ns() + PATIENCE_NS, (self._sensor.fileno(),))
            if not self._take_block() and not is_there:
                raise SensorError(f"no samples for {PATIENCE_NS / _NS_PER_S:g} s: start the converter and its program")
        joined = np.concatenate(self._values)
        self._values, self._size = [joined[count:]], len(joined) - count
        if np.isnan(joined[:count]).all(axis=0).any():
            raise LostWindowError("a channel has lost all its samples: check its connection")
        return joined[:count]

    def _take_block(self) -> bool:
        block = self._sensor.read()
        if block is None:
            return False
        # Of a converter that delivers them, infinities are lost samples.
        self._values.append(np.where(np.isfinite(block.values), block.values, np.nan))
        self._size += len(block.values)
        self._arrived_ns = block.arrived_ns
        return True

    def arrival_ns(self, samples_before_end: int) -> int:
        """Host time by which the sample this far before the end of the last window had come, at an even pace."""
        behind = samples_before_end + self._size
        return self._arrived_ns - int(behind * _NS_PER_S / self._sensor.form.sample_rate_hz)


def known_samples(values: Array) -> Array:
    """Samples with lost ones replaced by the mean of their channel; the loss is a fault of its own."""
    if not np.isnan(values).any():
        return values
    return np.where(np.isnan(values), np.nanmean(values, axis=0), values)
