"""Events of an effect file to one effect: transients become clicks, continuous courses steady drives in steps.

Theory of operation
-------------------
An effect is one sequence of segments, at each time a click, a steady drive or quiet, so events that overlap have to be
decided between, and each event gets a report of what became of it.

- **Intensity to level.** Intensity 1 is `full_level_db` above the threshold, and intensity is an amplitude: half of it
  is 6 dB less. Levels are whole dB, finer than anyone feels. What comes out below 0 dB is not felt and not played.
- **Clicks first.** A click is what one finger can feel alone within a short time. A continuous event of at most SHORT_S
  is a click too. Clicks last 30 ms and two in less are felt as one: a click that comes up to MOST_SHIFT_S too early is
  moved, an earlier one is joined to the click before, which takes the greater level.
- **Drives between the clicks.** Elsewhere the strongest continuous event is played, in steps of STEP_S whose level is
  the power mean over the step; a step that differs by less than SAME_DB from the one before goes on at its level. The
  firmware ramps between steps. What is shorter than a step is left out.
- **Frequency is not part of an effect**: the placement of the fingers decides which one finger can feel alone.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from base.arrays import Array, Mask
from engine.device.toml_table import read_text
from engine.effects.files import ahap, haptic, hjif
from engine.effects.files.json_part import CLICK_MS, MOST_EVENT_S, Event, Kind, Part, Pattern
from engine.effects.rules import NS_PER_MS, Effect, EffectError, Segment

FULL_LEVEL_DB = 25.0  # level of intensity 1 unless stated: that of the named effect `press`
STEP_MS = 20  # below the border of pulse and vibration, to follow a course
SHORT_S, MOST_SHIFT_S = 0.040, 0.010  # of a click of 30 ms: a third longer is one too, a third late is in time
SAME_DB, JUMP_DB = 1.5, 3.0  # a finger tells about 1.5 dB; a jump is twice that
MOST_SEGMENTS = 1024  # 20 s of steps that all differ; bounds the memory of an effect
_NS_PER_S = 1_000_000_000
FORMATS: Mapping[str, Callable[[Part], Pattern]] = MappingProxyType(
    {ahap.FORMAT: ahap.read_ahap, haptic.FORMAT: haptic.read_haptic, hjif.FORMAT: hjif.read_hjif}
)
"""Readers by format, which is also the ending of a file's name."""
MOST_BYTES = 4 << 20  # an event of 35 bytes each millisecond of the longest effect, 120 s


class Fate(StrEnum):
    """What becomes of an event."""

    KEPT = "kept"  # it is played at its time and, to 2 dB, at its level
    CHANGED = "changed"  # it is played, and differs in time or length, or others interrupt it
    JOINED = "joined"  # it is one with the click of another event, or wholly covered by clicks
    LOST = "lost"  # it is not played


@dataclass
class EventReport:
    """What became of one event."""

    event: Event
    fate: Fate = Fate.KEPT
    played: str = ""  # what the event is played as, such as "click 20 dB at 5 ms"
    notes: list[str] = field(default_factory=list)

    def change(self, note: str, fate: Fate = Fate.CHANGED) -> None:
        """Note a difference."""
        self.notes.append(note)
        self.fate = fate

    def plain(self) -> dict[str, object]:
        """The report as plain values."""
        event = self.event
        return {
            "event": event.source,
            "kind": str(event.kind),
            "start_s": event.start_s,
            "stop_s": event.stop_s,
            "intensity": event.peak,
            "fate": str(self.fate),
            "played": self.played,
            "notes": list(self.notes),
            "not_kept": list(event.unused),
        }


@dataclass(frozen=True)
class Converted:
    """An effect, and the report of each event of its file, in the order of the file."""

    name: str
    segments: tuple[Segment, ...]  # empty where nothing of the file is felt
    pattern: Pattern
    reports: tuple[EventReport, ...]

    @property
    def effect(self) -> Effect:
        """The effect. Raises EffectError where nothing of the file is felt."""
        if not self.segments:
            raise EffectError(f"{self.name}: its file has no event that is felt: give its intensity 1 another level")
        return Effect(self.name, self.segments)

    def number(self, fate: Fate) -> int:
        """How many events met this fate."""
        return sum(report.fate is fate for report in self.reports)

    @property
    def summary(self) -> str:
        """The number of events by fate, in words."""
        told = [f"{self.number(fate)} {fate}" for fate in Fate if self.number(fate)]
        return f"{len(self.reports)} events: {', '.join(told) or 'none'}"


@dataclass
class _Click:
    start_ms: int
    level_db: float
    first: EventReport


def level_of(intensity: float, full_level_db: float) -> float | None:
    """Level of an intensity in whole dB; None for one that is not felt."""
    level_db = full_level_db + 20 * math.log10(intensity) if intensity > 0 else -math.inf
    return None if level_db < -0.5 else float(max(0, round(level_db)))


def convert(pattern: Pattern, name: str, full_level_db: float = FULL_LEVEL_DB) -> Converted:
    """The effect called `name` of a pattern. Raises EffectError for one of too many segments, or of too long events."""
    event_s = sum(event.stop_s - event.start_s for event in pattern.events)
    if event_s > MOST_EVENT_S:
        long = f"its events last {event_s:.0f} s in all"
        raise EffectError(f"{name}: {long}; expected at most {MOST_EVENT_S:g} s: shorten them, or leave some out")
    reports = tuple(EventReport(event) for event in pattern.events)
    clicks = _clicks(reports, full_level_db)
    segments = _segments(clicks, _drives(reports, clicks, full_level_db))
    if len(segments) > MOST_SEGMENTS:
        raise EffectError(f"{name}: {len(segments)} segments; expected at most {MOST_SEGMENTS}: shorten the file")
    return Converted(name, segments, pattern, reports)


def _clicks(reports: tuple[EventReport, ...], full_level_db: float) -> list[_Click]:
    """The clicks, in order of time; the reports of the events that they stand for are filled in."""
    wanted = []
    for report in reports:
        event = report.event
        if event.kind is Kind.OTHER:
            report.change(event.reason, Fate.LOST)
        elif event.kind is Kind.TRANSIENT or event.stop_s - event.start_s <= SHORT_S:
            level_db = level_of(event.peak, full_level_db)
            if level_db is None:
                report.change(f"intensity {event.peak:.2g} is below the threshold", Fate.LOST)
            else:
                wanted.append((round(1e3 * event.start_s), -level_db, report))
    clicks: list[_Click] = []
    for at_ms, negative_db, report in sorted(wanted, key=lambda each: each[:2]):
        level_db, free_ms = -negative_db, clicks[-1].start_ms + CLICK_MS if clicks else 0
        if free_ms - at_ms > 1e3 * MOST_SHIFT_S:
            last = clicks[-1]
            last.level_db = max(last.level_db, level_db)
            last.first.played = f"click {last.level_db:g} dB at {last.start_ms} ms"
            report.change(f"{at_ms - last.start_ms} ms after the click of {last.first.event.source}", Fate.JOINED)
            continue
        click = _Click(max(at_ms, free_ms), level_db, report)
        clicks.append(click)
        report.played = f"click {level_db:g} dB at {click.start_ms} ms"
        if click.start_ms > at_ms:
            report.change(f"{click.start_ms - at_ms} ms later, as the click before lasts {CLICK_MS} ms")
        if report.event.kind is Kind.CONTINUOUS:
            length_ms = 1e3 * (report.event.stop_s - report.event.start_s)
            report.change(f"its {length_ms:.3g} ms are a click of {CLICK_MS} ms")
    return clicks


def _drives(reports: tuple[EventReport, ...], clicks: list[_Click], full_level_db: float) -> Array:
    """The level of the steady drive in each millisecond, NaN where it is quiet or a click is played."""
    long = [
        report
        for report in reports
        if report.event.kind is Kind.CONTINUOUS and report.event.stop_s - report.event.start_s > SHORT_S
    ]
    length = max([round(1e3 * report.event.stop_s) for report in long], default=0)
    strongest, owner = np.zeros(length), np.full(length, -1)
    own: list[tuple[slice, Array]] = []
    for number, report in enumerate(long):
        event = report.event
        span = slice(round(1e3 * event.start_s), round(1e3 * event.stop_s))
        time_s = (np.arange(span.start, span.stop) + 0.5) / 1e3
        course = np.interp(time_s, *np.array(event.points).T)
        is_stronger = course > strongest[span]
        strongest[span][is_stronger], owner[span][is_stronger] = course[is_stronger], number
        own.append((span, course))
    is_click = np.zeros(length, bool)
    for click in clicks:
        is_click[click.start_ms : click.start_ms + CLICK_MS] = True
    levels_db = _steps(strongest, is_click, full_level_db)
    for number, (report, (span, course)) in enumerate(zip(long, own, strict=True)):
        is_felt = course >= 10 ** (-(full_level_db + 0.5) / 20)
        _report_drive(report, number, is_felt, owner[span], is_click[span], levels_db[span])
    return levels_db


def _steps(strongest: Array, is_click: Mask, full_level_db: float) -> Array:
    """The course of intensities (millisecond,) as steps of level."""
    levels_db = np.full(len(strongest), math.nan)
    exact_db = full_level_db + 20 * np.log10(np.maximum(strongest, 1e-12))
    is_drive = ~is_click & (exact_db >= -0.5)
    # A stretch ends where a drive begins or ends, and where the course jumps: steps begin when these do.
    changes = is_drive[1:] != is_drive[:-1]
    jumps = abs(np.diff(exact_db)) > JUMP_DB
    edges = [0, *(np.flatnonzero(changes | jumps) + 1).tolist(), len(strongest)]
    for start, stop in pairwise(edges):
        if start == stop or not is_drive[start]:
            continue
        parts = max(1, round((stop - start) / STEP_MS))
        bounds = np.linspace(start, stop, parts + 1).round().astype(int)
        before: float | None = None
        for first, last in pairwise(bounds.tolist()):
            exact = math.sqrt(float((strongest[first:last] ** 2).mean()))
            level_db = level_of(exact, full_level_db) if last - first >= STEP_MS // 2 else None
            if level_db is not None and before is not None:
                level_db = before if abs(full_level_db + 20 * math.log10(exact) - before) < SAME_DB else level_db
            before = level_db
            if level_db is not None:
                levels_db[first:last] = level_db
    return levels_db


def _report_drive(
    report: EventReport, number: int, is_felt: Mask, owner: NDArray[np.int_], is_click: Mask, levels_db: Array
) -> None:
    """Say what became of one continuous event; all arrays (millisecond,) cover its time."""
    felt_ms, is_own = int(is_felt.sum()), owner == number
    if not felt_ms:
        report.change(f"intensity {report.event.peak:.2g} is below the threshold", Fate.LOST)
        return
    is_played = is_felt & is_own & np.isfinite(levels_db)
    played_ms = int(is_played.sum())
    if played_ms:
        low_db, high_db = levels_db[is_played].min(), levels_db[is_played].max()
        span = f"{low_db:g} dB" if low_db == high_db else f"{low_db:g} to {high_db:g} dB"
        report.played = f"drive {span} for {played_ms} ms"
    clicked, hidden = int((is_felt & is_own & is_click).sum()), int((is_felt & ~is_own).sum())
    left_out = felt_ms - played_ms - clicked - hidden
    fate = Fate.CHANGED if played_ms else Fate.JOINED if clicked > hidden + left_out else Fate.LOST
    if clicked:
        report.change(f"clicks take the place of {clicked} ms", fate)
    if hidden:
        report.change(f"others are as strong or stronger for {hidden} ms", fate)
    if left_out >= STEP_MS or (left_out and not played_ms):
        report.change(f"{left_out} ms are too short for a step or end below the threshold", fate)


def _segments(clicks: list[_Click], levels_db: Array) -> tuple[Segment, ...]:
    """Clicks, steps of level, and pauses between them, without one at the end."""
    marks: list[tuple[int, int, float, bool]] = [
        (click.start_ms, click.start_ms + CLICK_MS, click.level_db, True) for click in clicks
    ]
    changes = np.flatnonzero(np.diff(np.nan_to_num(levels_db, nan=-1.0), prepend=math.nan, append=math.nan))
    for start, stop in pairwise(changes.tolist()):
        if math.isfinite(levels_db[start]):
            marks.append((start, stop, float(levels_db[start]), False))
    segments, end_ms = [], 0
    for start, stop, level_db, is_click in sorted(marks):
        if start > end_ms:
            segments.append(Segment((start - end_ms) * NS_PER_MS, None))
        segments.append(Segment(None if is_click else (stop - start) * NS_PER_MS, level_db, is_click=is_click))
        end_ms = stop
    return tuple(segments)


def read_effect_file(path: Path, name: str, full_level_db: float = FULL_LEVEL_DB) -> Converted:
    """The effect called `name` of a file; `full_level_db` is the level of its intensity 1.

    Raises EffectError for what is no effect file; OSError when there is no such file.
    """
    file_format = path.suffix.removeprefix(".").lower()
    if file_format not in FORMATS:
        raise EffectError(f"{path}: ends in {path.suffix!r}; expected {', '.join('.' + each for each in FORMATS)}")
    if path.stat().st_size > MOST_BYTES:
        raise EffectError(f"{path}: {path.stat().st_size} bytes; expected at most {MOST_BYTES}: shorten the file")
    return decode_effect_file(Part.parse(read_text(path, EffectError), str(path)), file_format, name, full_level_db)


def decode_effect_file(document: Part, file_format: str, name: str, full_level_db: float = FULL_LEVEL_DB) -> Converted:
    """The same for a document that was read already, in one of `FORMATS`. Raises EffectError."""
    return convert(FORMATS[file_format](document), name, full_level_db)
