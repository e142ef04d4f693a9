"""Control steps: what a program asks of the player between two touch frames. Values only."""

from dataclasses import dataclass
from enum import StrEnum

from engine.effects.rules import Effect, Effects


class Outcome(StrEnum):
    """What became of a control step."""

    DONE = "done"
    NO_FINGER = "no finger"
    """The finger that it names does not touch the bar; nothing was done."""
    OFF_BAR = "off the bar"
    """The place that it names is beyond the end of the bar that plays now; nothing was done."""
    QUIET = "quiet"
    """A program keeps the finger that it names quiet; nothing was triggered."""


@dataclass(frozen=True)
class TriggeredEffect:
    """An effect that a program begins at a finger or at a place: one of `contact_id` and `position_m` is given."""

    effect: Effect
    owner: int
    """Number of the program: the effects that it triggered end together."""
    contact_id: int | None = None
    position_m: float | None = None
    """From the start of the bar. A finger within engine.touch.placement.CLOSEST_M of it gets the effect; without one
    the place is felt, as if a finger had just left it, so the effect must end by itself."""


@dataclass(frozen=True)
class ControlStep:
    """One request of a program; its parts are taken in the order of the fields."""

    effects: Effects | None = None
    """The rules from now on; None: as before."""
    ended_owner: int | None = None
    """The program whose triggered effects end now; None: none does."""
    roles: tuple[tuple[int, bool], ...] = ()
    """Contact ids, and whether the finger is kept quiet whatever its rules say, until it lifts."""
    trigger: TriggeredEffect | None = None
