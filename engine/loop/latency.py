"""Times of each command on its way from report to wire, to percentiles."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

Stamps = tuple[int, int, int, int, int, int]
"""Time of each stage in ns, in the order of `Stage`, all of one clock."""


class Stage(IntEnum):
    """What had just been done."""

    AVAILABLE = 0
    """The report could be read: when it was due from a playback; when the loop woke for it from a live device."""
    READ = 1
    FRAME = 2
    """The frame was complete."""
    STATE = 3
    """The state of the zones was known."""
    COMMAND = 4
    """The encoded drive was looked up and handed to the link."""
    WRITTEN = 5
    """The port had taken the whole command."""


@dataclass(frozen=True)
class Percentiles:
    """Percentiles of `count` durations, ns. Each is one of the samples: the least that this share stays within.

    Interpolation between samples would show tails better than any sample.
    """

    count: int
    p10_ns: int
    p50_ns: int
    p90_ns: int
    p99_ns: int
    p99_9_ns: int
    p99_99_ns: int
    max_ns: int

    @classmethod
    def of(cls, durations_ns: ArrayLike) -> "Percentiles | None":
        """Of those durations that are numbers, ns, of any shape; None without one."""
        known_ns = np.asarray(durations_ns, np.float64)
        known_ns = known_ns[np.isfinite(known_ns)]
        if not len(known_ns):
            return None
        values = np.percentile(known_ns, [10, 50, 90, 99, 99.9, 99.99, 100], method="inverted_cdf")
        return cls(len(known_ns), *(round(value) for value in values.tolist()))


class LatencyRecorder:
    """The stamps of the last `capacity` commands; recording allocates nothing that stays."""

    def __init__(self, capacity: int = 65_536) -> None:
        if capacity < 1:
            raise ValueError(f"capacity is {capacity}; expected at least 1")
        self.count = 0
        """Commands recorded since the start."""
        self._stamps_ns = np.zeros((capacity, len(Stage)), np.int64)

    def record(self, stamps: Stamps) -> None:
        """Keep one command's stamps, in place of the oldest where all are taken."""
        self._stamps_ns[self.count % len(self._stamps_ns)] = stamps
        self.count += 1

    def stamps_ns(self) -> NDArray[np.int64]:
        """A copy of what is kept, shape (command, stage), oldest first."""
        capacity = len(self._stamps_ns)
        if self.count <= capacity:
            return self._stamps_ns[: self.count].copy()
        return np.roll(self._stamps_ns, -(self.count % capacity), axis=0)

    def summarise(self, first: Stage = Stage.AVAILABLE, last: Stage = Stage.WRITTEN) -> Percentiles | None:
        """Durations from one stage to a later one; None without a sample."""
        stamps_ns = self.stamps_ns()
        return Percentiles.of(stamps_ns[:, last] - stamps_ns[:, first])
