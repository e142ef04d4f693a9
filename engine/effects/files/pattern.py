"""What the three formats of effect files have in common: events at times, each with a course of intensities."""

from dataclasses import dataclass
from enum import StrEnum

from engine.effects.files.json_part import Part

MOST_PARTS = 10_000
"""Events, and points of their courses, that references and curves of a file may make; ten times its most segments.

Without a bound a few kB of references to effects of references take hours, and a control channel answers no other
program meanwhile. So each part is counted before it is made, and so is each effect that makes none."""
MOST_EVENT_S = 1200.0  # all continuous events of a file: ten of the longest; each millisecond is compared


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
