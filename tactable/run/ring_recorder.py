"""The ring of a run to a recording: a process of its own, which the loop never waits for."""

import json
import os
import select
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from engine.loop.ring import RingReader, RingWriter
from engine.touch.sources import Source
from engine.touch.sources.recording import Recording, Report, write_recording

_MEMORY = Path("/dev/shm")
# A thousandth of what the ring holds at the pace of the fastest digitizer.
_PERIOD_S = 0.02
_NS_PER_S = 1e9
_US_PER_S = 1e6


@contextmanager
def ring_for(path: Path | None, *, is_needed: bool) -> Iterator[RingWriter | None]:
    """A ring where one is asked for or needed, removed at the end; None otherwise. Raises RingError."""
    if path is None and not is_needed:
        yield None
        return
    where = _MEMORY if _MEMORY.is_dir() else None
    with (
        tempfile.TemporaryDirectory(prefix="tactable-", dir=where) as folder,
        RingWriter(path or Path(folder) / "ring") as ring,
    ):
        yield ring


@contextmanager
def recorder_of(ring: Path, output: Path, source: Source, bus: int) -> Iterator[None]:
    """A process that records what the ring tells of a source, until the end; then it has written `output`."""
    head = {
        "ring": str(ring),
        "output": str(output),
        "name": source.name,
        "bus": bus,
        "vendor_id": source.vendor_id,
        "product_id": source.product_id,
        "descriptor": source.descriptor.hex(),
    }
    process = subprocess.Popen(
        [sys.executable, "-m", "tactable.run.ring_recorder", json.dumps(head)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,  # Ctrl-C is for the run: this one ends after it
    )
    assert process.stdout is not None
    process.stdout.readline()
    try:
        yield
    finally:
        process.communicate()


def main() -> None:
    """Say that the ring is open, then read it until standard input ends."""
    head: dict[str, Any] = json.loads(sys.argv[1])
    with RingReader(Path(head["ring"])) as reader:
        sys.stdout.write("open\n")
        sys.stdout.flush()
        reports = _collect(reader)
        lost = reader.lost
    numbers = (head["bus"], head["vendor_id"], head["product_id"])
    recording = Recording(head["name"], *numbers, bytes.fromhex(head["descriptor"]), tuple(reports))
    write_recording(recording, Path(head["output"]))
    if lost:
        sys.stderr.write(f"note: {lost} records of the run were overwritten before they were recorded\n")


def _collect(reader: RingReader) -> list[Report]:
    reports: list[Report] = []
    first_ns, is_over = 0, False
    while not is_over:
        is_over = bool(select.select([sys.stdin], [], [], _PERIOD_S)[0]) and not os.read(sys.stdin.fileno(), 1)
        for record in reader.read():
            if record.report:
                first_ns = first_ns if reports else record.time_ns
                # The form has microseconds.
                time_s = round((record.time_ns - first_ns) / _NS_PER_S * _US_PER_S) / _US_PER_S
                reports.append(Report(len(reports), time_s, record.report))
    return reports


if __name__ == "__main__":
    main()
