"""Control steps: what a program asks of the player between two touch frames. Values only."""

from dataclasses import dataclass
from enum import StrEnum

from engine.effects.rules import Effect, Rule


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
