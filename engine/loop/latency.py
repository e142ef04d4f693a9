"""Times of each command on its way from report to wire, to percentiles."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

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
class LatencySummary:
    """Durations in ns over `count` samples. Each percentile is one of them: the least that this share stays within."""

    count: int
    p50_ns: int
    p90_ns: int
    p99_ns: int
    p99_9_ns: int
    max_ns: int


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

    def summarise(self, first: Stage = Stage.AVAILABLE, last: Stage = Stage.WRITTEN) -> LatencySummary | None:
        """Durations from one stage to a later one; None without a sample."""
        stamps_ns = self.stamps_ns()
        if not len(stamps_ns):
            return None
        durations_ns = stamps_ns[:, last] - stamps_ns[:, first]
        # The empirical distribution itself: interpolation would show tails better than any sample.
        percentiles = np.percentile(durations_ns, [50, 90, 99, 99.9, 100], method="inverted_cdf")
        return LatencySummary(len(durations_ns), *(int(value) for value in percentiles))
