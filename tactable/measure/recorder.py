"""Samples of a sensor in windows of a wanted length, the drive kept alive while they come."""

import numpy as np
from numpy.typing import NDArray

from tactable.measure.driven_device import DrivenDevice
from tactable.measure.sensor import Sensor, SensorError

Array = NDArray[np.float64]

PATIENCE_NS = 3_000_000_000
"""A converter that says nothing for longer has stopped."""
_NS_PER_S = 1_000_000_000


class Recorder:
    """Takes windows of samples from a sensor while a device is driven.

    Raises SensorError where no samples come, LinkError as `DrivenDevice.wait`.
    """

    def __init__(self, driven: DrivenDevice, sensor: Sensor) -> None:
        self._driven, self._sensor = driven, sensor
        self._values = [np.empty((0, len(sensor.form.channels)))]
        self._size = 0
        self._arrived_ns = 0

    def drop(self) -> None:
        """Forget the samples that have come so far."""
        while self._sensor.read() is not None:
            pass
        self._values, self._size = self._values[:1], 0
        self._values[0] = self._values[0][:0]

    def take(self, seconds: float) -> Array:
        """The next window (sample, channel); it follows the one before without a gap."""
        count = round(seconds * self._sensor.form.sample_rate_hz)
        clock = self._driven.clock
        while self._size < count:
            is_there = self._driven.wait(clock.now_ns() + PATIENCE_NS, (self._sensor.fileno(),))
            block = self._sensor.read()
            if block is None and not is_there:
                raise SensorError(f"no samples for {PATIENCE_NS / _NS_PER_S:g} s: start the converter and its program")
            if block is not None:
                self._values.append(block.values)
                self._size += len(block.values)
                self._arrived_ns = block.arrived_ns
        joined = np.concatenate(self._values)
        self._values, self._size = [joined[count:]], len(joined) - count
        return joined[:count]

    def arrival_ns(self, samples_before_end: int) -> int:
        """Host time by which the sample this far before the end of the last window had come, at an even pace."""
        behind = samples_before_end + self._size
        return self._arrived_ns - int(behind * _NS_PER_S / self._sensor.form.sample_rate_hz)
