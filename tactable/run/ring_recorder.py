"""Records the reports of a run from its ring, in a child process that the loop never waits for."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from base.child import START_TIMEOUT_S, Child, Parent
from base.files import check_folder_of
from base.work_folder import work_folder
from engine.loop import RingReader, RingWriter
from engine.touch.sources import Source
from engine.touch.sources.recording import Recording, Report, write_recording

# At the pace of the fastest digitizer a thousandth of the ring is written meanwhile.
_PERIOD_S = 0.02
_NS_PER_S = 1e9
_US_PER_S = 1e6


@contextmanager
def ring_for(path: Path | None, *, is_needed: bool) -> Iterator[RingWriter | None]:
    """A ring where one is wanted or needed, removed at the end; else None. Raises RingError."""
    if path is not None:
        with RingWriter(path) as ring:
            yield ring
    elif is_needed:
        with work_folder("ring", in_memory=True) as folder, RingWriter(folder / "ring") as ring:
            yield ring
    else:
        yield None


@contextmanager
def recorder_of(ring: Path, output: Path, source: Source, bus: int) -> Iterator[None]:
    """Record the reports in the ring while the context lasts, then write `output`. Raises ChildError at its end."""
    head = {
        "ring": str(ring),
        "output": str(output),
        "name": source.name,
        "bus": bus,
        "vendor_id": source.vendor_id,
        "product_id": source.product_id,
        "descriptor": source.descriptor.hex(),
    }
    child = Child("tactable.run.ring_recorder", head, name="the recorder")
    try:
        child.read(START_TIMEOUT_S)
        yield
        child.ask_to_end()
        child.read()  # however long the writing takes; raises where it failed
    finally:
        child.end(timeout_s=None)


def main(parent: Parent, head: dict[str, Any]) -> None:
    """Say that the ring is open, read it until the run ends, and write the recording."""
    check_folder_of(Path(head["output"]))  # now, not when hours of touches are to be written
    with RingReader(Path(head["ring"])) as reader:
        parent.say({})
        reports = _collect(reader, parent)
        lost = reader.lost
    numbers = (head["bus"], head["vendor_id"], head["product_id"])
    recording = Recording(head["name"], *numbers, bytes.fromhex(head["descriptor"]), tuple(reports))
    write_recording(recording, Path(head["output"]))
    parent.say({})
    if lost:
        sys.stderr.write(f"note: {lost} records of the run were overwritten before they were recorded\n")


def _collect(reader: RingReader, parent: Parent) -> list[Report]:
    reports: list[Report] = []
    first_ns, is_over = 0, False
    while not is_over:
        is_over = parent.has_spoken(_PERIOD_S)  # the run says nothing more: that is its end
        for record in reader.read():
            if record.report:
                first_ns = first_ns if reports else record.time_ns
                # The form has microseconds.
                time_s = round((record.time_ns - first_ns) / _NS_PER_S * _US_PER_S) / _US_PER_S
                reports.append(Report(len(reports), time_s, record.report))
    return reports
