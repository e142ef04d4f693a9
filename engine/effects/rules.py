"""Effects, the rules that say which finger gets which effect at which event (tables/EFFECTS.md), and control steps.

A control step is what a program asks of the player between two touch frames. Values only.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from base.errors import TactableError
from base.points import is_between
from engine.device.toml_table import HIGHEST_LEVEL_DB
from engine.table.levels import DEFAULT_LEVEL_DB
from engine.touch import Touch

LOWEST_LEVEL_DB = -20.0  # a change of level may lead below the curve: people differ from it by 8 dB, and more are tried
FULL_SCALE_DB = math.inf  # the level that stands for as much as full scale gives
NS_PER_MS = 1_000_000


class EffectError(TactableError, ValueError):
    """A rule file is wrong; the message names file, key, value and what was expected."""


class Trigger(StrEnum):
    """The event that gives a finger its effect."""

    TOUCH = "touch"  # it comes down
    HOLD = "hold"  # it has rested for the time of the rule
    LIFT = "lift"  # it lifts, or the digitizer has lost it
    DRAG = "drag"  # it has travelled the distance of the rule


class Drives(StrEnum):
    """Source of steady drives: positions or zones."""

    POSITIONS = "positions"  # they are solved for where the fingers are, with the fingers on the bar
    ZONES = "zones"  # the row of the sweep for the zones of the felt fingers, the bar untouched: the published method


class Segment(NamedTuple):
    """A stretch of an envelope."""

    duration_ns: int | None  # None: as long as the event lasts (only in the last segment), or the length of the click
    level_db: float | None  # wanted sensation level, dB above threshold; infinite: full scale; None: quiet
    is_click: bool = False  # play the table's click for the state of the zones, instead of its steady drive


@dataclass(frozen=True)
class Effect:
    """An envelope of levels over time, from the event on; empty: no effect begins, which leaves a place out."""

    name: str
    envelope: tuple[Segment, ...]

    @property
    def is_endless(self) -> bool:
        """Whether it lasts as long as its event, or until a program ends it."""
        return any(segment.duration_ns is None and not segment.is_click for segment in self.envelope)


@dataclass(frozen=True)
class Rule:
    """Gives an effect to the fingers that cause an event in some zones or in a region."""

    on: Trigger
    effect: Effect
    zones: frozenset[int] | None = None  # indices of the zones; None: any
    region_m: tuple[complex, complex] | None = None  # first and last corner, both included; None: anywhere
    after_ns: int = 0  # how long a finger rests before a HOLD
    every_m: float = 0.0  # how far a finger travels for each DRAG
    level_change_db: float = 0.0  # what is added to each level of the effect
    along: complex = 0.0  # the direction that counts for a DRAG, 1 along a plate or 1j across it; 0: any, and on a bar

    def covers(self, touch: Touch) -> bool:
        """Whether the rule applies to a finger at this place."""
        if self.zones is not None:
            return touch.zone in self.zones
        if self.region_m is not None:
            return is_between(touch.position_m, *self.region_m)
        return True


def changed_level(level_db: float | None, change_db: float) -> float | None:
    """Another level, kept from LOWEST_LEVEL_DB to HIGHEST_LEVEL_DB; full scale stays, and a pause stays a pause."""
    if level_db is None or math.isinf(level_db):
        return level_db
    return min(max(level_db + change_db, LOWEST_LEVEL_DB), HIGHEST_LEVEL_DB)


@dataclass(frozen=True)
class Effects:
    """The rules of a run, in order: for each trigger the first rule that covers the finger wins."""

    rules: tuple[Rule, ...]
    others: tuple[Effect, ...] = ()  # effects without a rule that a program may play, which a run prepares as well
    drives: Drives = Drives.POSITIONS

    @property
    def levels_db(self) -> tuple[float, ...]:
        """All levels of all effects, rising; infinite: full scale."""
        segments = self._segments()
        return tuple(sorted({segment.level_db for segment in segments if segment.level_db is not None}))

    @property
    def have_clicks(self) -> bool:
        """Whether any effect is played by clicks; zones have none: a row of the sweep is on for as long as a click."""
        return self.drives is Drives.POSITIONS and any(segment.is_click for segment in self._segments())

    def _segments(self) -> Iterator[Segment]:
        effects = (*(rule.effect for rule in self.rules), *self.others)
        return (segment for effect in effects for segment in effect.envelope)

    def of(self, trigger: Trigger) -> tuple[Rule, ...]:
        """The rules on one trigger, in order."""
        return tuple(rule for rule in self.rules if rule.on is trigger)


def burst(level_db: float, duration_ms: int) -> Effect:
    """An effect of one level for a stated time."""
    return Effect("burst", (Segment(duration_ms * NS_PER_MS, level_db),))


def click(level_db: float) -> Effect:
    """An effect of one click."""
    return Effect("click", (Segment(None, level_db, is_click=True),))


DEFAULT_EFFECTS = Effects((Rule(Trigger.TOUCH, click(DEFAULT_LEVEL_DB)),))  # every touch feels a click at 20 dB


class Outcome(StrEnum):
    """Result of a control step: done, or why not."""

    DONE = "done"
    NO_FINGER = "no finger"  # the finger that it names does not touch the bar; nothing was done
    OFF_BAR = "off the bar"  # the place that it names is beyond the end of the bar that plays now; nothing was done
    QUIET = "quiet"  # a program keeps the finger that it names quiet; nothing was triggered
    OFF = "off"  # a program has switched feeling off; nothing was triggered


@dataclass(frozen=True)
class SceneSettings:
    """Settings of the whole bar. They apply to everything that is played on it, by rules or by programs."""

    is_enabled: bool = True  # False: nothing is felt
    uses_rule_file: bool = True  # whether the rules that the run began with hold where no region is
    level_change_db: float = 0.0


@dataclass(frozen=True)
class TriggeredEffect:
    """An effect that a program begins at a finger or at a place: one of `contact_id` and `position_m` is given."""

    effect: Effect
    owner: int  # number of the program: the effects that it triggered end together
    contact_id: int | None = None
    position_m: complex | None = None
    """A finger within engine.touch.placement.CLOSEST_M of this point gets the effect; without one the place is felt, as
    if a finger had just left it, so the effect must end by itself."""
    level_change_db: float = 0.0


@dataclass(frozen=True)
class Role:
    """A finger is kept quiet for a program until it lifts or the program is gone, or follows its rules again."""

    contact_id: int
    is_quiet: bool  # False: no program keeps it quiet any more
    owner: int


@dataclass(frozen=True)
class ControlStep:
    """One request of a program; its parts are taken in the order of the fields."""

    rules: tuple[Rule, ...] | None = None  # of programs from now on, before those of the run; None: as before
    settings: SceneSettings | None = None  # None: as before
    stopped_owner: int | None = None  # the program whose triggered effects end now; None: none does
    gone_owner: int | None = None  # the program whose triggered effects and quiet fingers end now; None: none does
    are_all_gone: bool = False  # those of all programs end
    role: Role | None = None
    trigger: TriggeredEffect | None = None
