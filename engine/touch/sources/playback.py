"""Plays a recording: its reports come at their recorded times, or faster."""

import math

from engine.touch.sources.recording import Recording

NS_PER_S = 1_000_000_000
PAUSE_NS = NS_PER_S  # pause between two repetitions of a recording
_AT_ONCE_NS = 0  # any clock is past this


class Playback:
    """A recording as a Source; it begins with the first read.

    At `speed` 2 everything comes twice as fast. With None a report is due as soon as the one before is read; after the
    last one time goes on at the clock's pace, so that a watchdog still acts. With `repeats` it begins again after
    PAUSE_NS and never ends. Raises ValueError for a speed that is not a finite number above 0.
    """

    def __init__(
        self, recording: Recording, speed: float | None = 1.0, report_id: int | None = None, *, repeats: bool = False
    ) -> None:
        if speed is not None and not 0 < speed < math.inf:
            raise ValueError(f"speed is {speed!r}; expected a number above 0, or None for as fast as possible")
        self.name, self.report_id = recording.name, report_id
        self.descriptor = recording.descriptor
        self.vendor_id = recording.vendor_id
        self.product_id = recording.product_id
        self.report_index = 0
        self.report_time_ns = 0
        self._reports = tuple(report.data for report in recording.reports)
        self._times_ns = tuple(round(report.time_s * NS_PER_S) for report in recording.reports)
        self._is_unpaced = speed is None
        self._speed = 1.0 if speed is None else speed
        self.repeats = repeats and bool(self._reports)  # whether it begins again after its end
        self._next = 0
        # A clock time and the same moment on the recording's axis.
        self._anchor_clock_ns = self._anchor_source_ns = 0

    @property
    def ended(self) -> bool:
        """Whether every report has been read."""
        return self._next == len(self._reports) and not self.repeats

    def fileno(self) -> None:
        """A recording has no descriptor."""

    def next_time_ns(self) -> int | None:
        """Clock time at which the next report is due: at once for the first; None after the last."""
        if self.ended:
            return None
        if self._is_unpaced or self._next == 0:
            return _AT_ONCE_NS
        return self.clock_time_ns(self._time_ns(self._next))

    def _time_ns(self, index: int) -> int:
        """Time of a report on the recording's axis, which goes on through all repetitions."""
        turn, each = divmod(index, len(self._reports))
        return self._times_ns[each] + turn * (self._times_ns[-1] - self._times_ns[0] + PAUSE_NS)

    def read(self, now_ns: int) -> bytes | None:
        """The next report if it is due."""
        due_ns = self.next_time_ns()
        if due_ns is None or now_ns < due_ns:
            return None
        index = self._next
        if self._is_unpaced or index == 0:
            self._anchor_clock_ns, self._anchor_source_ns = now_ns, self._time_ns(index)
        self._next += 1
        self.report_index, self.report_time_ns = index, self._time_ns(index)
        return self._reports[index % len(self._reports)]

    def source_time_ns(self, now_ns: int) -> int:
        """Time in the recording at a clock time."""
        return self._anchor_source_ns + round((now_ns - self._anchor_clock_ns) * self._speed)

    def clock_time_ns(self, source_time_ns: int) -> int:
        """Clock time at which the recording is at a time, or the first ns past it."""
        return self._anchor_clock_ns + math.ceil((source_time_ns - self._anchor_source_ns) / self._speed)
