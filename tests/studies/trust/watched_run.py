"""A real `tactable run` on an emulated firmware, watched through its ring while its table is changed. SIMULATED."""

import os
import select
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from engine.loop.ring import RingError, RingReader
from engine.touch.sources.recording import Recording, Report, write_recording
from firmware_link.emulator.emulator_process import run_emulator
from firmware_link.protocol.link_errors import LinkError
from tactable.rig.virtual_digitizer import BUS, NAME, PRODUCT_ID, VENDOR_ID, descriptor_of, report_of
from tests.tactable.rules import HELD

_REST_S, _RATE_HZ = 3600.0, 5
_LOOK_S = 0.02


class WatchedRun:
    """The process, its ring and its standard error; `reports` counts what it has read of the touch screen."""

    def __init__(self, table: Path, recording: Path, port: str, folder: Path) -> None:
        self.reports, self._said = 0, ""
        effects, self._ring_path = folder / "held.toml", folder / "ring"
        self._ring_path.unlink(missing_ok=True)  # a run that was killed leaves its ring
        effects.write_text(HELD, encoding="utf-8")
        words = ["run", str(table), "--touch", str(recording), "--port", port, "--rules", str(effects)]
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
        self.reports += sum(record.report_index is not None and bool(record.report) for record in self._ring.read())
        assert self._process.stderr is not None
        ready, _, _ = select.select([self._process.stderr], [], [], _LOOK_S)
        if ready:
            data = os.read(self._process.stderr.fileno(), 1 << 16)
            self._said += data.decode()
            if not data:
                self._look_alive()

    def wait_for_reports(self, count: int) -> None:
        """Return once `count` reports were read."""
        while self.reports < count:
            self._look_alive()
            self.look()

    def kill(self) -> None:
        """End the process in any case."""
        if self._process.poll() is None:
            self._process.kill()
        self._process.communicate()


@contextmanager
def resting_run(table: Path, folder: Path) -> Iterator[WatchedRun]:
    """A run with a finger at rest, for up to an hour."""
    path, rest = folder / "touches.hid", [(0, True, 0.5)]
    times_s = [index / _RATE_HZ for index in range(round(_REST_S * _RATE_HZ))]
    reports = tuple(Report(index, at_s, report_of(rest, at_s, slots=1)) for index, at_s in enumerate(times_s))
    write_recording(Recording(NAME, BUS, VENDOR_ID, PRODUCT_ID, descriptor_of(1), reports), path)
    with run_emulator() as emulator:
        run = WatchedRun(table, path, emulator.stable_port, folder)
        try:
            run.wait_for_reports(1)
            yield run
        finally:
            run.kill()
