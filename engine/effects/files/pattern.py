"""What the three formats of effect files have in common: events at times, each with a course of intensities."""

from dataclasses import dataclass
from enum import StrEnum


class Kind(StrEnum):
    """What an event is."""

    TRANSIENT = "transient"
    CONTINUOUS = "continuous"
    OTHER = "other"
    """No vibration that an actuator could play, such as a sound."""


@dataclass(frozen=True)
class Event:
    """One event of an effect file."""

    source: str
    """Where it stands in the file, such as "Pattern[3]"."""
    kind: Kind
    points: tuple[tuple[float, float], ...]
    """(time in s, intensity from 0 to 1) in order of time, straight lines between; a transient has one point."""
    unused: tuple[str, ...] = ()
    """What the file says of it that no drive can keep, such as "sharpness 0.4"."""
    reason: str = ""
    """Why an event of kind OTHER is not played."""

    @property
    def start_s(self) -> float:
        """When it begins, from the start of the effect."""
        return self.points[0][0] if self.points else 0.0

    @property
    def stop_s(self) -> float:
        """When it ends; a transient ends when it begins."""
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
