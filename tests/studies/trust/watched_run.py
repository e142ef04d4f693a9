"""A real `tactable run` on an emulated firmware, watched through its ring while its table is changed. SIMULATED."""

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

from engine.loop.command_latency import Stage
from engine.loop.ring import Record, RingError, RingReader
from engine.touch.sources.recording import Recording, Report, write_recording
from firmware_link.emulator.emulator_process import run_emulator
from firmware_link.protocol.link_errors import LinkError
from tactable.rig.virtual_digitizer import BUS, NAME, PRODUCT_ID, VENDOR_ID, descriptor_of, report_of
from tests.tactable.rules import HELD

STEP_S = 0.02
"""Time after which the finger of `touches` jumps to the next place."""
_LOOK_S = 0.02


@dataclass
class Seen:
    """Records of one run's ring: report indices and read times, latency of commands, times of changes of table."""

    index: list[int] = field(default_factory=list)
    read_ns: list[int] = field(default_factory=list)
    due_to_written: list[int] = field(default_factory=list)
    change_ns: list[int] = field(default_factory=list)
    lost: int = 0

    def take(self, record: Record) -> None:
        """Add one record."""
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
    """The process, its ring and its standard error; `end` or `kill` ends it."""

    def __init__(self, table: Path, recording: Path, port: str, folder: Path) -> None:
        self.table, self.seen, self._said = table, Seen(), ""
        effects, self._ring_path = folder / "held.toml", folder / "ring"
        self._ring_path.unlink(missing_ok=True)  # a run that was killed leaves its ring
        effects.write_text(HELD, encoding="utf-8")
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
        """Take the new records and messages; waits for 20 ms at most."""
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
        """Return once `count` reports were read."""
        while len(self.seen.index) < count:
            self._look_alive()
            self.look()

    def wait_for_change(self) -> None:
        """Return once the run plays another table than when this was called."""
        before = len(self.seen.change_ns)
        while len(self.seen.change_ns) == before:
            self._look_alive()
            self.look()

    def end(self) -> dict[str, Any]:
        """Interrupt the run and return its summary."""
        self._process.send_signal(signal.SIGINT)
        told, said = self._process.communicate()
        if self._process.returncode != 0:
            raise LinkError(f"the run ended with exit status {self._process.returncode}: {self._said}{said.decode()}")
        self._ring.close()
        summary: dict[str, Any] = json.loads(told)
        return summary

    def kill(self) -> None:
        """End the process in any case."""
        if self._process.poll() is None:
            self._process.kill()
        self._process.communicate()


@contextmanager
def watched_run(table: Path, recording: Recording, folder: Path) -> Iterator[WatchedRun]:
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
    """A run with a finger at rest, for up to an hour."""
    with watched_run(table, touches(3600.0, 5, (0.5,)), folder) as run:
        run.wait_for_reports(1)
        yield run


def touches(seconds: float, rate_hz: int, places: Sequence[float]) -> Recording:
    """One finger that is always down and jumps from place to place (fractions of the bar)."""
    times_s = [index / rate_hz for index in range(round(seconds * rate_hz))]
    reports = tuple(
        Report(index, time_s, report_of([(0, True, places[int(time_s / STEP_S) % len(places)])], time_s, slots=1))
        for index, time_s in enumerate(times_s)
    )
    return Recording(NAME, BUS, VENDOR_ID, PRODUCT_ID, descriptor_of(1), reports)
