"""Estimates a digitizer's scan period from its Scan Time, and the jitter that transport and host add."""

from dataclasses import dataclass

import numpy as np

_LONGEST_PERIOD_NS = 30_000_000  # a longer interval between two frames is a pause between touches
_FEWEST = 50  # 0.4 s of an 8 ms digitizer; of fewer, a 99th percentile is the greatest


@dataclass(frozen=True)
class ScanPeriods:
    """Statistics over consecutive frames: the digitizer's period by its own clock, and the jitter of host time.

    The device's tick of nominally 100 us is 92-131 us, so the period is scaled to host time over all frames. `jitter`
    is the difference between host and device interval of two frames; the device's own steps are 0.1 ms.
    """

    frames: int
    period_ns: int  # median
    jitter_p99_ns: int


class ScanTimes:
    """Host and scan time of the last `capacity` frames; recording allocates nothing that stays."""

    def __init__(self, capacity: int = 65_536) -> None:
        if capacity < 2:
            raise ValueError(f"capacity is {capacity}; expected at least 2")
        self._count = 0
        self._times_ns = np.zeros((capacity, 2), np.int64)

    def record(self, time_ns: int, scan_time_ns: int) -> None:
        """Keep the times of one frame, in place of the oldest once `capacity` is reached."""
        self._times_ns[self._count % len(self._times_ns)] = time_ns, scan_time_ns
        self._count += 1

    def summarise(self) -> ScanPeriods | None:
        """Over intervals between frames of one touch; None with fewer than 50, or where the scan time stands still."""
        kept, capacity = self._times_ns[: self._count], len(self._times_ns)
        if self._count > capacity:
            kept = np.roll(kept, -(self._count % capacity), axis=0)
        host_ns, scan_ns = np.diff(kept, axis=0).T
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
