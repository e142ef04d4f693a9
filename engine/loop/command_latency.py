"""Latency of commands, by the stamps of each stage from report to wire, and periods of scans, kept for a run.

The period of a digitizer is estimated from its Scan Time, with the jitter that transport and host add.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from base.arrays import Integers

Stamps = tuple[int, int, int, int, int, int]  # clock time of each stage in ns, in the order of `Stage`
_LONGEST_PERIOD_NS = 30_000_000  # a longer interval between two frames is a pause between touches
_FEWEST = 50  # 0.4 s of an 8 ms digitizer; of fewer, a 99th percentile is the greatest


class Stage(IntEnum):
    """The stages from a report to its written command; a stamp is taken at the end of each."""

    AVAILABLE = 0  # The report could be read. A playback knows when; for a live device it is when the loop read it.
    READ = 1
    FRAME = 2  # the touch frame was complete
    STATE = 3  # what the fingers are to feel was known
    COMMAND = 4  # the command was looked up and handed to the link
    WRITTEN = 5  # the port had taken the whole command


@dataclass(frozen=True)
class Percentiles:
    """Percentiles of `count` durations, ns: for each the smallest sample that this share does not exceed.

    Not interpolated, because interpolation between the last samples would understate the tail.
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
        """Percentiles of the finite values of some durations, ns, of any shape; None where no value is finite."""
        known_ns = np.asarray(durations_ns, np.float64)
        known_ns = known_ns[np.isfinite(known_ns)]
        if not len(known_ns):
            return None
        values = np.percentile(known_ns, [10, 50, 90, 99, 99.9, 99.99, 100], method="inverted_cdf")
        return cls(len(known_ns), *(round(value) for value in values.tolist()))


class _Latest:
    """The last `capacity` rows of times, ns, in memory that is allocated once."""

    columns: ClassVar[int]

    def __init__(self, capacity: int = 65_536) -> None:
        self.count = 0  # rows recorded since the start
        self._rows_ns = np.zeros((capacity, self.columns), np.int64)

    def record(self, *row: int) -> None:
        """Keep a row, in place of the oldest when the memory is full."""
        self._rows_ns[self.count % len(self._rows_ns)] = row
        self.count += 1

    def rows_ns(self) -> Integers:
        """A copy of the kept rows, shape (row, column), oldest first."""
        capacity = len(self._rows_ns)
        return np.roll(self._rows_ns[: self.count], -(self.count % capacity) if self.count > capacity else 0, axis=0)


class LatencyRecorder(_Latest):
    """The stamps of the last commands, in the order of `Stage`."""

    columns = len(Stage)

    def summarise(self, first: Stage = Stage.AVAILABLE, last: Stage = Stage.WRITTEN) -> Percentiles | None:
        """Percentiles of the durations from one stage to a later one; None without a command."""
        stamps_ns = self.rows_ns()
        return Percentiles.of(stamps_ns[:, last] - stamps_ns[:, first])


@dataclass(frozen=True)
class ScanPeriods:
    """Statistics over consecutive frames: the digitizer's period by its own clock, and the jitter of host time.

    The device's tick of nominally 100 us is 92-131 us, so the period is scaled to host time over all frames. `jitter`
    is the difference between host and device interval of two frames; the device's own steps are 0.1 ms.
    """

    frames: int
    period_ns: int  # median
    jitter_p99_ns: int


class ScanTimes(_Latest):
    """Host and scan time of the last frames."""

    columns = 2

    def summarise(self) -> ScanPeriods | None:
        """Over intervals between frames of one touch; None with fewer than 50, or where the scan time stands still."""
        host_ns, scan_ns = np.diff(self.rows_ns(), axis=0).T
        # A reset of the counter shows as an interval that is the host's own.
        follows = (host_ns < _LONGEST_PERIOD_NS) & (host_ns > 0) & (scan_ns > 0) & (scan_ns < 2 * _LONGEST_PERIOD_NS)
        host_ns, scan_ns = host_ns[follows], scan_ns[follows]
        if len(host_ns) < _FEWEST:
            return None
        scale = host_ns.sum() / scan_ns.sum()
        jitter_ns = abs(host_ns - scale * scan_ns)
        period_ns = np.percentile(scale * scan_ns, 50, method="inverted_cdf")
        p99_ns = np.percentile(jitter_ns, 99, method="inverted_cdf")
        return ScanPeriods(len(host_ns), round(period_ns), round(p99_ns))
