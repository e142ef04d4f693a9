"""A real `tactable run` on an emulated firmware, looked on through its ring while its table is changed. SIMULATED."""

import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.loop.latency import Stage
from engine.loop.ring import Record, RingError, RingReader
from engine.table.history import replace_table
from engine.touch.sources.recording import Recording, Report, write_recording
from firmware_link.emulator.process import run_emulator
from firmware_link.protocol.errors import LinkError
from tactable.bench.latency.load import Load, load_running
from tactable.rig.virtual_digitizer import BUS, NAME, PRODUCT_ID, VENDOR_ID, descriptor_of, report_of

Times = NDArray[np.int64]

RATE_HZ = 1000
FRAME_NS = 1_000_000
WAITING_REPORTS = 63
"""What hidraw keeps for a program that does not read."""
_SEGMENT_CHANGES = 100
_SEGMENT_S, _CONTROL_S = 150.0, 30.0
_STEP_S = 0.02  # the finger is in another zone so often
_PLACES = (0.1, 0.3, 0.5, 0.7, 0.9)
_AFTER_NS = 20_000_000
"""A change shows in the reports that are due so long after it, or it does not."""
_LOOK_S = 0.02
_HELD = '[[effect]]\nname = "held"\nenvelope = [["held", "20 dB"]]\n[[rule]]\non = "touch"\neffect = "held"\n'


@dataclass
class Seen:
    """What the ring of one run told: report indices and when they were read; stamps of commands; changes of table."""

    index: list[int] = field(default_factory=list)
    read_ns: list[int] = field(default_factory=list)
    due_to_written: list[int] = field(default_factory=list)
    change_ns: list[int] = field(default_factory=list)
    lost: int = 0

    def take(self, record: Record) -> None:
        """One more record."""
        if record.report_index is None:
            # A finger rests or jumps: time alone brings nothing else. A command that left later is told twice.
            if record.time_ns not in self.change_ns[-1:]:
                self.change_ns.append(record.time_ns)
        elif record.report:
            self.index.append(record.report_index)
            self.read_ns.append(record.time_ns)
        if record.report_index is not None and record.drive_sequence is not None and record.stamps_ns[Stage.AVAILABLE]:
            stamps = record.stamps_ns
            self.due_to_written.append(stamps[Stage.WRITTEN] - stamps[Stage.AVAILABLE])


class WatchedRun:
    """The process, its ring, and what it says; end it with `end`."""

    def __init__(self, table: Path, recording: Path, port: str, folder: Path) -> None:
        self.table, self.seen, self._said = table, Seen(), ""
        effects, self._ring_path = folder / "held.toml", folder / "ring"
        effects.write_text(_HELD, encoding="utf-8")
        words = ["run", str(table), "--touch", str(recording), "--port", port, "--effects", str(effects)]
        words += ["--bit-rate", "2000000", "--ring", str(self._ring_path), "--reconnect", "--realtime", "all", "--json"]
        command = [sys.executable, "-c", "from tactable.cli.main import main; main()", *words]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        self._ring = self._open_ring()

    def _open_ring(self) -> RingReader:
        while True:
            with suppress(RingError):  # not made yet, or not whole
                return RingReader(self._ring_path, from_start=True)
            self._look_alive()
            time.sleep(_LOOK_S)

    def _look_alive(self) -> None:
        if self._process.poll() is not None:
            assert self._process.stderr is not None
            raise LinkError(f"the run has ended by itself: {self._said}{self._process.stderr.read().decode()}")

    def look(self) -> None:
        """Take what the ring has and what was said; never waits longer than a moment."""
        for record in self._ring.read():
            self.seen.take(record)
        self.seen.lost = self._ring.lost
        assert self._process.stderr is not None
        ready, _, _ = select.select([self._process.stderr], [], [], _LOOK_S)
        if ready:
            data = os.read(self._process.stderr.fileno(), 1 << 16)
            self._said += data.decode()
            if not data:
                self._look_alive()

    def wait_for_reports(self, count: int) -> None:
        """Until so many were read."""
        while len(self.seen.index) < count:
            self._look_alive()
            self.look()

    def wait_for_change(self) -> None:
        """Until the run plays another table than when this was called."""
        before = len(self.seen.change_ns)
        while len(self.seen.change_ns) == before:
            self._look_alive()
            self.look()

    def end(self) -> dict[str, Any]:
        """Its summary."""
        self._process.send_signal(signal.SIGINT)
        told, said = self._process.communicate()
        if self._process.returncode != 0:
            raise LinkError(f"the run ended with exit status {self._process.returncode}: {self._said}{said.decode()}")
        self._ring.close()
        summary: dict[str, Any] = json.loads(told)
        return summary

    def kill(self) -> None:
        """Leave no process."""
        if self._process.poll() is None:
            self._process.kill()
        self._process.communicate()


@contextmanager
def _running(table: Path, recording: Recording, folder: Path) -> Iterator[WatchedRun]:
    path = folder / "touches.hid"
    write_recording(recording, path)
    with run_emulator() as emulator:
        run = WatchedRun(table, path, emulator.stable_port, folder)
        try:
            yield run
        finally:
            run.kill()


@contextmanager
def resting_run(table: Path, folder: Path) -> Iterator[WatchedRun]:
    """A run with a finger at rest; for up to ten minutes."""
    with _running(table, touches(600.0, 20, (0.5,)), folder) as run:
        run.wait_for_reports(1)
        yield run


def touches(seconds: float, rate_hz: int, places: Sequence[float]) -> Recording:
    """One finger that is always down and jumps from place to place (fractions of the bar)."""
    times_s = [index / rate_hz for index in range(round(seconds * rate_hz))]
    reports = tuple(
        Report(index, time_s, report_of([(0, True, places[int(time_s / _STEP_S) % len(places)])], time_s, slots=1))
        for index, time_s in enumerate(times_s)
    )
    return Recording(NAME, BUS, VENDOR_ID, PRODUCT_ID, descriptor_of(1), reports)


@dataclass(frozen=True)
class Segment:
    """One run: its summary, lateness of every report (ns), and when they were due and tables changed."""

    summary: dict[str, Any]
    lost: int
    late_ns: Times
    due_ns: Times
    due_to_written_ns: Times
    change_ns: Times

    def pauses_ns(self, instants_ns: Times) -> Times:
        """How late the latest report was of those due about each instant; a moment without any counts as 0."""
        first, last = (np.searchsorted(self.due_ns, instants_ns + reach) for reach in (-_AFTER_NS, _AFTER_NS))
        return np.array([self.late_ns[a:b].max(initial=0) for a, b in zip(first, last, strict=True)], np.int64)


def measure_changes(tables: tuple[Path, Path], count: int, load: Load, folder: Path) -> dict[str, Any]:
    """`count` changes between two tables under RATE_HZ reports a second, and in between runs without one."""
    with_changes, without, left = list[Segment](), list[Segment](), count
    with load_running(load):
        while left > 0:
            wanted = min(left, _SEGMENT_CHANGES)
            with_changes.append(_measure(tables, wanted, _SEGMENT_S, folder))
            without.append(_measure(tables, 0, min(_CONTROL_S, with_changes[-1].late_ns.size / RATE_HZ + 2), folder))
            left -= max(1, len(with_changes[-1].change_ns))
    pauses = np.concatenate([segment.pauses_ns(segment.change_ns) for segment in with_changes])
    pairs = zip(without, with_changes, strict=True)
    others = [segment.pauses_ns(_even(segment, len(other.change_ns))) for segment, other in pairs]
    return {
        "load": load.value,
        "with": _figures(with_changes),
        "without": _figures(without),
        "pause_ms": _quantiles(pauses),
        "no_pause_ms": _quantiles(np.concatenate(others)),
    }


def _measure(tables: tuple[Path, Path], changes: int, seconds: float, folder: Path) -> Segment:
    table = folder / "played.nc"
    _put(tables[0], table)
    with _running(table, touches(seconds, RATE_HZ, _PLACES), folder) as run:
        run.wait_for_reports(RATE_HZ)  # settled
        for number in range(changes):
            if len(run.seen.index) > RATE_HZ * (seconds - 5):
                break
            _put(tables[(number + 1) % 2], table)
            run.wait_for_change()
        while not changes and len(run.seen.index) < RATE_HZ * (seconds - 1):
            run.look()
        run.look()
        summary = run.end()
        seen = run.seen
    index, read_ns = np.array(seen.index, np.int64), np.array(seen.read_ns, np.int64)
    due_ns = read_ns[0] + (index - index[0]) * FRAME_NS
    return Segment(
        summary=summary,
        lost=seen.lost + int((np.diff(index) - 1).sum()),
        late_ns=read_ns - due_ns,
        due_ns=due_ns,
        due_to_written_ns=np.array(seen.due_to_written, np.int64),
        change_ns=np.array(seen.change_ns, np.int64),
    )


def _put(source: Path, table: Path) -> None:
    """Another file in the table's place, as a build puts it there."""
    new = table.with_name("new.nc")
    new.hardlink_to(source)
    replace_table(new, table)


def _even(segment: Segment, count: int) -> Times:
    return np.linspace(segment.due_ns[0], segment.due_ns[-1], count + 2)[1:-1].astype(np.int64)


def _figures(segments: Sequence[Segment]) -> dict[str, Any]:
    written_ns = np.concatenate([segment.due_to_written_ns for segment in segments])
    late_ns = np.concatenate([segment.late_ns for segment in segments])
    late = int((written_ns >= FRAME_NS).sum())
    digitizers = [segment.summary["digitizer"] for segment in segments]
    return {
        "changes": sum(len(segment.change_ns) for segment in segments),
        "changes_counted_by_the_run": sum(segment.summary["changes_of_table"] for segment in segments),
        "reports": sum(segment.summary["reports"] for segment in segments),
        "sessions_lost": sum(segment.summary["reconnects"] for segment in segments),
        "reports_lost": sum(segment.lost for segment in segments) + sum(each["lost_frames"] for each in digitizers),
        "reports_63_ms_late": int((late_ns >= WAITING_REPORTS * FRAME_NS).sum()),
        "commands": len(written_ns),
        "commands_late": late,
        "commands_late_percent": 100 * late / max(1, len(written_ns)),
        "command_p50_ms": float(np.percentile(written_ns, 50)) / 1e6,
        "command_p99_ms": float(np.percentile(written_ns, 99)) / 1e6,
        "command_max_ms": float(written_ns.max()) / 1e6,
        "report_p99_ms": float(np.percentile(late_ns, 99)) / 1e6,
        "report_max_ms": float(late_ns.max()) / 1e6,
    }


def _quantiles(found_ns: Times) -> dict[str, float]:
    values = {name: np.percentile(found_ns, percent) for name, percent in (("50 %", 50), ("90 %", 90), ("99 %", 99))}
    return {name: float(value) / 1e6 for name, value in {**values, "greatest": found_ns.max()}.items()}
