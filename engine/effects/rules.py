"""What fingers feel, as values: effects, and the rules that say which finger gets which, when (tables/EFFECTS.md)."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

from engine.table.entry import DEFAULT_LEVEL_DB
from engine.touch import Touch
from firmware_link.protocol.errors import TactableError

FULL_SCALE_DB = math.inf
"""The level that stands for as much as full scale gives."""
NS_PER_MS = 1_000_000


class EffectError(TactableError, ValueError):
    """A rule file is wrong; the message names file, key, value and what was expected."""


class Trigger(StrEnum):
    """What a finger does to get an effect."""

    TOUCH = "touch"
    """It comes down."""
    HOLD = "hold"
    """It has rested for a time."""
    LIFT = "lift"
    """It leaves, or the digitizer has lost it."""
    DRAG = "drag"
    """It has travelled a distance."""


@dataclass(frozen=True)
class Segment:
    """A stretch of an envelope."""

    duration_ns: int | None
    """None: while the condition lasts that the effect began with; only the last segment. A click has its own length."""
    level_db: float | None
    """Wanted sensation level, dB above threshold; infinite: full scale; None: not felt."""
    is_click: bool = False
    """The table's click of the moment's state, instead of its steady drive."""


@dataclass(frozen=True)
class Effect:
    """What a finger feels from the moment that a rule gives it the effect."""

    name: str
    envelope: tuple[Segment, ...]


@dataclass(frozen=True)
class Rule:
    """Which fingers get an effect, and when."""

    on: Trigger
    effect: Effect
    zones: frozenset[int] | None = None
    """Zones by their index; None: not asked for."""
    region_m: tuple[float, float] | None = None
    """From where to where along the bar, ends included; None: not asked for."""
    after_ns: int = 0
    """How long a finger rests before a HOLD."""
    every_m: float = 0.0
    """How far a finger travels along the bar for each DRAG."""

    def covers(self, touch: Touch) -> bool:
        """Whether the rule is for a finger there."""
        if self.zones is not None:
            return touch.zone in self.zones
        if self.region_m is not None:
            start_m, stop_m = self.region_m
            return start_m <= touch.position_m <= stop_m
        return True


@dataclass(frozen=True)
class Effects:
    """The rules of a run, in order: for each trigger the first that covers the finger wins."""

    rules: tuple[Rule, ...]

    @property
    def levels_db(self) -> tuple[float, ...]:
        """Every level that a finger may be wanted to feel, rising."""
        segments = self._segments()
        return tuple(sorted({segment.level_db for segment in segments if segment.level_db is not None}))

    @property
    def have_clicks(self) -> bool:
        """Whether any rule plays clicks."""
        return any(segment.is_click for segment in self._segments())

    def _segments(self) -> Iterator[Segment]:
        return (segment for rule in self.rules for segment in rule.effect.envelope)

    def of(self, trigger: Trigger) -> tuple[Rule, ...]:
        """The rules on one trigger, in order."""
        return tuple(rule for rule in self.rules if rule.on is trigger)


def burst(level_db: float, duration_ms: int) -> Effect:
    """One level for a while."""
    return Effect("burst", (Segment(duration_ms * NS_PER_MS, level_db),))


def click(level_db: float) -> Effect:
    """One click."""
    return Effect("click", (Segment(None, level_db, is_click=True),))


DEFAULT_EFFECTS = Effects((Rule(Trigger.TOUCH, click(DEFAULT_LEVEL_DB)),))
"""Every touch feels a click at 20 dB."""
