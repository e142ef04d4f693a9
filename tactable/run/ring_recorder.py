"""Records the reports of a run from its ring, in a child process that the loop never waits for."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from base.child import START_TIMEOUT_S, Child, Parent
from base.files import check_folder_of
from base.printable import write_note
from base.work_folder import work_folder
from engine.loop.ring import RingReader, RingWriter
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
    head = Recording(source.name, bus, source.vendor_id, source.product_id, source.descriptor, ())
    child = Child("tactable.run.ring_recorder", {"ring": ring, "output": output, "head": head}, name="the recorder")
    try:
        child.read(START_TIMEOUT_S)
        yield
        child.ask_to_end()
        child.read()  # however long the writing takes; raises where it failed
    finally:
        child.end(timeout_s=None)


def main(parent: Parent, arguments: dict[str, Any]) -> None:
    """Say that the ring is open, read it until the run ends, and write the recording."""
    check_folder_of(arguments["output"])  # now, not when hours of touches are to be written
    with RingReader(arguments["ring"]) as reader:
        parent.say({})
        reports = _collect(reader, parent)
        lost = reader.lost
    write_recording(replace(arguments["head"], reports=tuple(reports)), arguments["output"])
    parent.say({})
    if lost:
        write_note(f"{lost} records of the run were overwritten before they were recorded")


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
