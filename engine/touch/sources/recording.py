"""Reads and writes recordings of reports in the text format of hid-recorder."""

from __future__ import annotations

import re
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from base.errors import TactableError
from base.files import replace_file

_EVENT_TIME = re.compile(r"[0-9]{1,12}\.[0-9]{6}")


class RecordingError(TactableError):
    """A recording cannot be read; the message gives file, line, cause and remedy."""

    def __init__(self, path: Path, line_number: int, problem: str, remedy: str) -> None:
        self.path = path
        self.line_number = line_number
        super().__init__(f"{path}, line {line_number}: {problem}; {remedy}")


@dataclass(frozen=True, slots=True)
class Report:
    """One report as the device sent it; `index` counts the device's reports from 0, `time_s` from the first one."""

    index: int
    time_s: float
    data: bytes


@dataclass(frozen=True, slots=True)
class Recording:
    """A device and what it reported; name "" and numbers 0 where the file does not say."""

    name: str
    bus: int
    vendor_id: int
    product_id: int
    descriptor: bytes
    reports: tuple[Report, ...]


def read_recording(path: Path) -> Recording:
    """The first device in a hid-recorder file.

    A file with several devices has a `D:` line before the lines of each; those of the others are passed over, and
    reports are counted per device. Raises `RecordingError`, also for a path that is no plain file, since a device may
    never end; and `OSError` where the file cannot be opened.
    """
    if not stat.S_ISREG(path.stat().st_mode):
        raise RecordingError(path, 1, "is not a plain file", "write the recording into one")
    name, identity, descriptor = "", (0, 0, 0), None
    reports: list[Report] = []
    for line_number, key, value in _first_device(path):
        line = _Line(path, line_number)
        if key == "N":
            name = value
        elif key == "I":
            identity = line.parse_identity(value)
        elif key == "R" and descriptor is not None:
            raise line.error("a second report descriptor", "split the file: it holds two recordings")
        elif key == "R":
            descriptor = line.parse_bytes(value)
        elif key == "E":
            reports.append(line.parse_event(value, len(reports)))
    if descriptor is None:
        raise RecordingError(path, 1, "no report descriptor (R: line)", "record it again with hid-recorder or tactable")
    return Recording(name, *identity, descriptor, tuple(reports))


def write_recording(recording: Recording, path: Path) -> None:
    """Write a recording as hid-tools reads it; the file appears whole or not at all. Raises `OSError`."""
    lines = [
        "D: 0",
        f"R: {_sized(recording.descriptor)}",
        f"N: {' '.join(recording.name.splitlines())}",
        f"I: {recording.bus:x} {recording.vendor_id:04x} {recording.product_id:04x}",
        *(f"E: {report.time_s:013.6f} {_sized(report.data)}" for report in recording.reports),
    ]
    with replace_file(path) as partial:
        partial.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _sized(data: bytes) -> str:
    return f"{len(data)} {data.hex(' ')}"


def _first_device(path: Path) -> Iterator[tuple[int, str, str]]:
    """Line number, key letter and value of each line of the first device; comments and unknown lines left out."""
    first: str | None = None
    current = "0"
    with path.open(encoding="utf-8", errors="replace") as lines:
        for line_number, line in enumerate(lines, start=1):
            key, separator, value = line.partition(":")
            if not separator or len(key) != 1:
                continue
            if key == "D":
                current = value.strip()
                continue
            first = current if first is None else first
            if current == first:
                yield line_number, key, value.strip()


@dataclass(frozen=True, slots=True)
class _Line:
    """File and line, for an error message."""

    path: Path
    number: int

    def error(self, problem: str, remedy: str) -> RecordingError:
        return RecordingError(self.path, self.number, problem, remedy)

    def parse_identity(self, value: str) -> tuple[int, int, int]:
        try:
            bus, vendor_id, product_id = (int(word, 16) for word in value.split())
        except ValueError:
            raise self.error(f"I: {value!r}", "expected bus, vendor and product as three hex numbers") from None
        return bus, vendor_id, product_id

    def parse_event(self, value: str, index: int) -> Report:
        time, _, data = value.partition(" ")
        if not _EVENT_TIME.fullmatch(time):
            raise self.error(f"time {time!r}", "expected seconds.microseconds, six digits after the point")
        return Report(index, float(time), self.parse_bytes(data))

    def parse_bytes(self, value: str) -> bytes:
        length, _, digits = value.partition(" ")
        try:
            size, data = int(length), bytes.fromhex(digits)
        except ValueError:
            raise self.error(f"bytes {value[:40]!r}", "expected a length, then bytes as pairs of hex digits") from None
        if size != len(data):
            raise self.error(f"length {size} but {len(data)} bytes", "the line is cut off or edited: record again")
        return data
