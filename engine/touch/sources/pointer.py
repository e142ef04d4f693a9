"""Turns pointer events of a page into reports, through a pipe on which the engine's one wait can wait."""

import math
import os
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from engine.touch.digitizer import Contact, DigitizerError
from engine.touch.sources import OnClock
from engine.touch.sources.own_reports import CONFIDENT, TIP, Axis, ContactReports

RESOLUTION = 65_535  # logical maximum of both axes
REPEAT_NS = 40_000_000  # a resting pointer is reported again: the digitizer releases silent contacts after 120 ms
SILENT_NS = 1_000_000_000  # a pressed pointer that the page has not mentioned for this long is released
_MOST_POINTERS = 10  # engine.touch.placement.MOST_FINGERS
_AXIS = Axis(0, RESOLUTION)
_REPORTS = ContactReports(_AXIS, _AXIS, contacts=1, maximum_contacts=_MOST_POINTERS)


class Phase(Enum):
    """What a pointer does; the browser's pointerdown, pointermove, pointerup, pointercancel."""

    DOWN = "down"
    MOVE = "move"
    UP = "up"
    CANCEL = "cancel"


@dataclass(frozen=True, slots=True)
class PointerEvent:
    """One event of one pointer: the browser's pointer id, the place as fractions of the drawn bar."""

    pointer_id: int
    x: float
    y: float
    phase: Phase


class PointerFeed:
    """The page's end of the pipe; it may live in another process than the source, which has at most ten pointers.

    The page mentions each pressed pointer by a `MOVE` now and then, moved or not: browsers lose releases, and a pointer
    that is not mentioned for a second is released. A page that is late, as on a busy machine, loses none.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def send(self, *events: PointerEvent) -> None:
        """Hand over events of different pointers that happened at once: they are one frame of the touch screen.

        Raises `DigitizerError` for a place that is no number, or when the engine is gone.
        """
        reports = b""
        for event in events:
            if not (math.isfinite(event.x) and math.isfinite(event.y)):
                raise DigitizerError(f"pointer {event.pointer_id} is at ({event.x}, {event.y}); expected two fractions")
            x, y = (round(RESOLUTION * min(max(place, 0.0), 1.0)) for place in (event.x, event.y))
            report = _REPORTS.encode([Contact(event.pointer_id, x, y, event.phase in (Phase.DOWN, Phase.MOVE))])
            # The first report of a frame has the number of its contacts, the others 0.
            reports += report[:-1] + bytes([0 if reports else len(events)])
        try:
            os.write(self._descriptor, reports)  # shorter than PIPE_BUF: the whole frame goes in, or nothing
        except OSError as error:
            raise DigitizerError(f"the engine takes no touches ({error}): start it again") from error

    def close(self) -> None:
        """End the source: what is pressed is released."""
        os.close(self._descriptor)


class _Pressed(NamedTuple):
    """The last report of a pressed pointer, when the engine got it, and when the page mentioned the pointer."""

    report: bytes
    reported_ns: int
    mentioned_ns: int


class PointerSource(OnClock):
    """The engine's end of the pipe, as a Source: a serial touch screen of ten fingers without a physical size."""

    name = "pointer events of a page"

    def __init__(self, descriptor: int) -> None:
        os.set_blocking(descriptor, False)
        self.descriptor = _REPORTS.descriptor
        self.ended = False  # the page is gone and all is released
        self._pipe = descriptor
        self._is_open = True
        self._pressed: dict[bytes, _Pressed] = {}  # by contact id, the longest unreported first

    def fileno(self) -> int | None:
        """The pipe, until its other end is closed."""
        return self._pipe if self._is_open else None

    def next_time_ns(self) -> int | None:
        """Time at which the pointer that is unreported for longest is reported again, or released."""
        if not self._pressed:
            return None
        return next(iter(self._pressed.values())).reported_ns + REPEAT_NS if self._is_open else 0

    def read(self, now_ns: int) -> bytes | None:
        """Return the next report, or None if nothing is due.

        An event in the pipe comes first. Otherwise the pointer whose last report is oldest is reported again once it is
        due: pressed, or released if the page has not mentioned it for SILENT_NS or has closed the pipe.
        """
        report = self._read_pipe()
        mentioned_ns = now_ns
        if not report:
            resting = next(iter(self._pressed.values()), None)
            if resting is None or (self._is_open and now_ns < resting.reported_ns + REPEAT_NS):
                self.ended = not self._is_open
                return None
            report, mentioned_ns = resting.report, resting.mentioned_ns
            if not self._is_open or now_ns - mentioned_ns >= SILENT_NS:
                report = report[:1] + bytes([CONFIDENT]) + report[2:]
            report = report[:-1] + b"\1"  # a frame of its own
        contact_id = report[2:6]
        self._pressed.pop(contact_id, None)
        if report[1] & TIP:
            self._pressed[contact_id] = _Pressed(report, now_ns, mentioned_ns)
        self.report_index += 1
        self.report_time_ns = now_ns
        return report

    def close(self) -> None:
        """Close this end too."""
        os.close(self._pipe)
        self._is_open = False
        self.ended = True

    def _read_pipe(self) -> bytes:
        """One report, or nothing; a pipe holds whole reports only, for each is written at once."""
        if not self._is_open:
            return b""
        try:
            report = os.read(self._pipe, _REPORTS.size_bytes)
        except BlockingIOError:
            return b""
        self._is_open = bool(report)
        return report
