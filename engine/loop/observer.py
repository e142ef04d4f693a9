"""The record of each report and its command, and the observers that get it: trace, latency, scan times, ring.

The loop calls its observer at the end of each pass, after the command of the pass is written: observing never delays a
command. Each report gives one record, and so does each change that time alone brings. Where the command of a record is
still waiting at the end of the pass (the line was busy), the record comes as WAITING, and once more, without
report and frame, when the command is written or replaced. Latency is by the stamps of each stage from report to wire;
the period of a digitizer is estimated from its Scan Time, with the jitter that transport and host add.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from base.arrays import Integers
from engine.touch import Placement, Touch, TouchFrame

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


class Fate(Enum):
    """Outcome of the command of a record."""

    NONE = "none"  # the report changed nothing that is wanted
    SAME = "same"  # something else is wanted, but its command is the one that the device holds already
    WAITING = "waiting"  # the link has it; the port has not taken it yet
    WRITTEN = "written"
    DROPPED = "dropped"  # a newer one replaced it unsent, or the link was not ready


class CommandRecord(NamedTuple):
    """One report, or one change that time alone brought: what is wanted from then on, and the command for it."""

    stamps_ns: Stamps  # clock time of each `Stage`; 0 for one that there was not, or before the command was taken
    report_index: int | None  # of the report that caused the change; None where time or the end of the run did
    report: bytes  # the report as the device sent it
    frame: TouchFrame | None  # the frame that the report completed
    placement: Placement | None  # the fingers that drives are made for, and their roles; None: no finger feels
    level_db: float | None  # wanted sensation level; None: no finger feels
    is_click: bool  # a click is wanted, not a steady drive
    touches: Sequence[Touch]
    drive: bytes  # the drive that the device holds from then on unless a waveform plays; empty for silence
    fate: Fate
    drive_sequence: int | None  # sequence of the SET or PLAY; None unless it was written
    play: bytes = b""  # the PLAY that this record's command is, behind its clock reference; empty for all else
    effect: str = ""  # name of the effect that is wanted; "": none is

    @property
    def time_ns(self) -> int:
        """When what is wanted was known; for a report that changed nothing, when it was read."""
        return self.stamps_ns[Stage.STATE] or self.stamps_ns[Stage.READ]


@dataclass
class LoopCounters:
    """What the loop did since it began. A command is a drive or a click that was sent; renewals do not count."""

    reports: int = 0
    frames: int = 0
    state_changes: int = 0
    commands: int = 0
    replaced: int = 0  # commands that a newer one replaced unsent
    lost_frames: int = 0  # frames that the digitizer lost
    losses: int = 0  # how often the port, or the device behind it, was lost
    reconnects: int = 0  # new sessions after a loss, or after the device stopped itself
    swaps: int = 0  # changes to another table
    controlled: int = 0  # control steps of programs
    learned: int = 0  # clicks that were solved beside the loop
    joined: int = 0  # times that something was wanted for fingers which are one to the bar, since they are too close
    left_out: int = 0  # times that something was wanted for more fingers than are placed


class Observer(Protocol):
    """The receiver of a loop's records."""

    def observe(self, record: CommandRecord, counters: LoopCounters) -> None:
        """Take one record; it is a value and may be kept. `counters` are the loop's own and go on counting."""


class Observers:
    """Several observers as one."""

    def __init__(self, *observers: Observer | None) -> None:
        self._calls = [observer.observe for observer in observers if observer is not None]

    def observe(self, record: CommandRecord, counters: LoopCounters) -> None:
        """Call each of them, in order."""
        for observe in self._calls:
            observe(record, counters)


class Trace(list[CommandRecord]):
    """Every change of what is wanted, in order, once the fate of its command is known."""

    def observe(self, record: CommandRecord, counters: LoopCounters) -> None:  # noqa: ARG002  # an Observer
        """Keep a change."""
        if record.fate is not Fate.NONE and record.fate is not Fate.WAITING:
            self.append(record)


class Timing:
    """Latency of the commands that a report caused, and the times of the digitizer's scans."""

    def __init__(self) -> None:
        self.latency, self.scan_times = LatencyRecorder(), ScanTimes()

    def observe(self, record: CommandRecord, counters: LoopCounters) -> None:  # noqa: ARG002  # an Observer
        """Record the stamps of a command that was written whole, and the frame's times where it has both."""
        stamps_ns, frame = record.stamps_ns, record.frame
        if stamps_ns[Stage.WRITTEN] and record.report_index is not None:
            self.latency.record(*stamps_ns)
        if frame is not None and frame.scan_time_ns is not None:
            self.scan_times.record(frame.time_ns, frame.scan_time_ns)
