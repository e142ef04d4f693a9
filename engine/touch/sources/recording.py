"""Reads and plays recordings of touch surfaces, and writes those of reports in the text format of hid-recorder."""

import math
import re
import stat
from dataclasses import dataclass
from pathlib import Path

from base.errors import TactableError
from base.files import write_text
from engine.touch.digitizer import open_digitizer

_EVENT_TIME, _LENGTH = re.compile(r"[0-9]{1,12}\.[0-9]{6}"), re.compile(r"[0-9]{1,5}")
_HEX = re.compile(r"[0-9a-fA-F \t\r]+=?\s*")
_QUOTED = re.compile(r"^[> \t]+", re.MULTILINE)
_LIBINPUT = re.compile(r"^devices:", re.MULTILINE)
# Its lines of bits and axes, and events of a type and code of four digits, which no length of hid-recorder has.
_EVEMU = re.compile(r"^(?:[AB]: [0-9a-f]{2} |E: [0-9.]+ [0-9a-f]{4} [0-9a-f]{4} -?\d+[ \t\r]*(?:#|$))", re.MULTILINE)
NS_PER_S = 1_000_000_000
PAUSE_NS = NS_PER_S  # pause between two repetitions of a recording
_AT_ONCE_NS = 0  # any clock is past this


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
    """The first touch surface of a recording by hid-recorder, evemu-record or `libinput record`.

    Lines may be quoted or folded by mail. In a hid-recorder file with several devices a `D:` line comes before the
    lines of each; reports are counted per device, and where none is a touch surface, the first is read. Raises
    `RecordingError`, also for a path that is no plain file, since a device may never end; and `OSError` where the file
    cannot be opened.
    """
    from engine.touch.sources.event_recording import read_evemu, read_libinput

    if not stat.S_ISREG(path.stat().st_mode):
        raise RecordingError(path, 1, "is not a plain file", "write the recording into one")
    text = _QUOTED.sub("", path.read_text(encoding="utf-8-sig", errors="replace"))
    if _LIBINPUT.search(text):
        return read_libinput(path, text)
    if _EVEMU.search(text):
        return read_evemu(path, text)
    devices = [_Device(path, lines) for lines in _lines_of_devices(text)]
    touch = [device for device in devices if device.is_touch_surface()]
    return next((device for device in touch if device.has_reports), (*touch, *devices, _Device(path, []))[0]).read()


def write_recording(recording: Recording, path: Path) -> None:
    """Write a recording as hid-tools reads it; the file appears whole or not at all. Raises `OSError`."""
    lines = [
        "D: 0",
        f"R: {_sized(recording.descriptor)}",
        f"N: {' '.join(recording.name.splitlines())}",
        f"I: {recording.bus:x} {recording.vendor_id:04x} {recording.product_id:04x}",
        *(f"E: {report.time_s:013.6f} {_sized(report.data)}" for report in recording.reports),
    ]
    write_text(path, "\n".join(lines) + "\n")


def _sized(data: bytes) -> str:
    return f"{len(data)} {data.hex(' ')}"


def _lines_of_devices(text: str) -> list[list[tuple[int, str, str]]]:
    """Line number, key letter and value of each line of each device; comments and unknown lines left out.

    A line of hex digits goes on with the one above, where that one has fewer bytes than it states.
    """
    devices, lines, missing = dict[str, list[tuple[int, str, str]]](), list[tuple[int, str, str]](), 0
    for number, line in enumerate(text.split("\n"), start=1):
        key, separator, value = line.partition(":")
        if separator and key == "D":
            lines, missing = devices.setdefault(value.strip(), []), 0
        elif separator and len(key) == 1:
            if not devices:
                lines = devices.setdefault("0", [])
            lines.append((number, key, value.strip()))
            missing = _missing_digits(key, value)
        elif missing > 0 and _HEX.fullmatch(line):
            above, key, value = lines[-1]
            # A quoted-printable mail ends a folded line, perhaps within a byte, with "=".
            lines[-1] = (above, key, value.removesuffix("=") + " " * (not value.endswith("=")) + line.strip())
            missing -= sum(character not in " \t\r=" for character in line)
    return [lines for lines in devices.values() if lines]


def _missing_digits(key: str, value: str) -> int:
    """How many hex digits a line of bytes has less than it states; 0 for other lines."""
    _, _, value = ("", "", value) if key == "R" else value.strip().partition(" ")
    length, _, digits = value.strip().partition(" ")
    if key not in ("R", "E") or not _LENGTH.fullmatch(length):
        return 0
    return 2 * int(length) - sum(character not in " \t\r=" for character in digits)


@dataclass(frozen=True, slots=True)
class _Device:
    """The lines of one device."""

    path: Path
    lines: list[tuple[int, str, str]]

    @property
    def has_reports(self) -> bool:
        return any(key == "E" for _, key, _ in self.lines)

    def is_touch_surface(self) -> bool:
        try:
            device = _Device(self.path, [line for line in self.lines if line[1] != "E"]).read()
            open_digitizer(device.descriptor, device.vendor_id, device.product_id)
        except TactableError:
            return False
        return True

    def read(self) -> Recording:
        name, identity, descriptor = "", (0, 0, 0), None
        reports: list[Report] = []
        for line_number, key, value in self.lines:
            line = _Line(self.path, line_number)
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
            remedy = "record it again with hid-recorder or tactable"
            raise RecordingError(self.path, 1, "no report descriptor (R: line)", remedy)
        return Recording(name, *identity, descriptor, tuple(reports))


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
