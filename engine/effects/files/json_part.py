"""Parts of a JSON document that are read key by key, and what they become: events at times, each with a course.

An error names file, place, value and what was expected.
"""

import json
import re
import reprlib
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from engine.effects.rules import EffectError

CLICK_MS = 30  # the border of pulse and vibration (docs/theory.md)
LONGEST_S = 120.0  # the longest effect that a file may hold: a slip in a time makes no table of gigabytes
LONGEST_WORD = 64  # of names; a row of a report stays a row

_STRING_OR_LAST_COMMA = re.compile(r'("(?:[^"\\]|\\[\s\S])*"?)|,(?=\s*[\]}])')
"""A string, also an unterminated one so that the scan stays linear, or a trailing comma, as in Apple's samples."""
_GREATEST = 1e300  # Python reads 1e999 as infinity; what is less can still be scaled and compared
MOST_PARTS = 10_000
"""Events, and points of their courses, that references and curves of a file may make; ten times its most segments.

Without a bound a few kB of references to effects of references take hours, and a control channel answers no other
program meanwhile. So each part is counted before it is made, and so is each effect that makes none."""
MOST_EVENT_S = 1200.0  # all continuous events of a file: ten of the longest; each millisecond is compared


class Part:
    """A value of a JSON document, and where it stands."""

    def __init__(self, source: str, path: str, value: Any) -> None:
        self.source, self.path, self.value = source, path, value

    @classmethod
    def parse(cls, text: str, source: str) -> "Part":
        """The whole of a document, with commas after the last value of a list or object. Raises EffectError."""
        try:
            return cls(source, "", read_json(_STRING_OR_LAST_COMMA.sub(lambda found: found[1] or "", text)))
        except (ValueError, RecursionError) as error:
            raise EffectError(f"{source}: not JSON: {error}") from None

    def error(self, expected: str) -> EffectError:
        """Make the error for this value; the caller raises it."""
        return EffectError(f"{self.source}: {self.path or 'document'}: {reprlib.repr(self.value)}: expected {expected}")

    def get(self, key: str) -> "Part | None":
        """The value of a key; None without it, or where it is null."""
        if not isinstance(self.value, dict):
            raise self.error("an object")
        value = self.value.get(key)
        return None if value is None else Part(self.source, f"{self.path}.{key}" if self.path else key, value)

    def need(self, key: str) -> "Part":
        """The value of a key that must be there."""
        part = self.get(key)
        if part is None:
            raise self.error(f"an object with the key {key!r}")
        return part

    def items(self) -> Iterator["Part"]:
        """The values of a list."""
        if not isinstance(self.value, list):
            raise self.error("a list")
        for number, value in enumerate(self.value):
            yield Part(self.source, f"{self.path}[{number}]", value)

    def list_of(self, key: str) -> list["Part"]:
        """The values of the list at a key; none without the key."""
        part = self.get(key)
        return [] if part is None else list(part.items())

    def number_of(self, key: str, default: float) -> float:
        """The number at a key; the default without the key."""
        part = self.get(key)
        return default if part is None else part.number()

    def text_of(self, key: str, default: str = "") -> str:
        """The text at a key; the default without the key."""
        part = self.get(key)
        return default if part is None else part.text()

    def number(self) -> float:
        """A number that is finite."""
        value = self.value
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= _GREATEST:
            raise self.error("a number")
        return float(value)

    def whole(self) -> int:
        """A whole number."""
        value = self.number()
        if value != round(value):
            raise self.error("a whole number")
        return round(value)

    def time_s(self) -> float:
        """A time from 0 to LONGEST_S."""
        value = self.number()
        if not 0 <= value <= LONGEST_S:
            raise self.error(f"0 to {LONGEST_S:g} s")
        return value

    def text(self) -> str:
        """A text."""
        if not isinstance(self.value, str):
            raise self.error("a text")
        return self.value

    def word(self) -> str:
        """A text of at most LONGEST_WORD characters: reports repeat it for each event."""
        if len(self.text()) > LONGEST_WORD:
            raise self.error(f"at most {LONGEST_WORD} characters")
        return self.text()


def read_json(text: str | bytes) -> Any:
    """The value of a JSON text; raises ValueError, also for the numbers that Python adds, and RecursionError."""
    return json.loads(text, parse_constant=_refuse_constant)


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is no number of JSON")


def clipped(intensity: float) -> float:
    """An intensity from 0 to 1, as the players of these formats clip it."""
    return min(max(intensity, 0.0), 1.0)


class Kind(StrEnum):
    """Kind of an event."""

    TRANSIENT = "transient"
    CONTINUOUS = "continuous"
    OTHER = "other"  # no vibration that an actuator could play, such as a sound


@dataclass(frozen=True)
class Event:
    """One event of an effect file."""

    source: str  # where it stands in the file, such as "Pattern[3]"
    kind: Kind
    points: tuple[tuple[float, float], ...]  # (time in s, intensity from 0 to 1), rising; of a transient one
    unused: tuple[str, ...] = ()  # what the file says of it that no drive can keep, such as "sharpness 0.4"
    reason: str = ""  # why an event of kind OTHER is not played

    @property
    def start_s(self) -> float:
        """Start of the event, from the start of the effect."""
        return self.points[0][0] if self.points else 0.0

    @property
    def stop_s(self) -> float:
        """End of the event; a transient ends when it begins."""
        return self.points[-1][0] if self.points else 0.0

    @property
    def peak(self) -> float:
        """Its greatest intensity."""
        return max((intensity for _, intensity in self.points), default=0.0)


@dataclass(frozen=True)
class Pattern:
    """All events of one effect file."""

    format: str
    description: str
    events: tuple[Event, ...]


class Budget:
    """Number of parts, such as events and points of courses, that one file may still make."""

    def __init__(self) -> None:
        self._left = MOST_PARTS

    def spend(self, count: int, part: Part) -> None:
        """Before this many parts are made of `part`. Raises EffectError where the file has made too many."""
        self._left -= count
        if self._left < 0:
            raise part.error(f"at most {MOST_PARTS} events and points of courses, references and curves included")
