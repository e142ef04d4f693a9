"""The record of each report and its command, and the observers that get it: trace, latency, scan times, ring.

The loop calls its observer at the end of each pass, after the command of the pass is written: observing never delays a
command. Each report gives one record, and so does each change that time alone brings. Where the command of a record is
still waiting at the end of the pass (the line was busy), the record comes as WAITING, and once more, without
report and frame, when the command is written or replaced.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple, Protocol

from engine.loop.command_latency import LatencyRecorder, ScanTimes, Stage, Stamps
from engine.touch import Placement, Touch, TouchFrame


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
