"""The scene: regions, effects and settings of all programs, which the loop puts above the run's own rules.

The newest region lies on top. Where a region is, neither the regions below it nor the rules of the run hold, not even
for an event that it has no rule for. What a program holds ends with its lease: its settings, its triggered effects, its
quiet fingers, the effects that it defined, and its regions but for those that stay. A program that sets a region or
defines an effect again takes it over. A region keeps the effects that it was set with, whatever becomes of their names.
"""

from base.points import is_within
from engine.effects.rules import Effect, SceneSettings
from tactable.control.requests import ControlError, Region

MOST_REGIONS = 32  # with 8 rules each; docs/programs.md has the time of a change beside them
MOST_DEFINED = 64  # of 16 segments at most: bounds the memory of a run


class Scene:
    """What all programs want; `named` are the effects that every run knows."""

    def __init__(self, named: dict[str, Effect]) -> None:
        self.effects = dict(named)  # the effects that a message may name
        self.regions: dict[str, Region] = {}  # the lowest first
        self.owners: dict[str, int] = {}  # the program that holds a region; of one that stays none, once it is gone
        self._definers: dict[str, int] = {}
        self._named = frozenset(named)
        self._settings: dict[int, SceneSettings] = {}

    def set_region(self, region: Region, owner: int) -> None:
        """Set a region; it keeps its place among the others if it was there. Raises ControlError for too many."""
        if region.name not in self.regions and len(self.regions) == MOST_REGIONS:
            raise ControlError(f"region.name: {region.name!r}: there are {MOST_REGIONS} regions: remove one first")
        self.regions[region.name], self.owners[region.name] = region, owner

    def remove_region(self, name: str) -> None:
        """Remove a region, whichever program set it. Raises ControlError where no region has this name."""
        if name not in self.regions:
            known = ", ".join(self.regions) or "there is none"
            raise ControlError(f"remove.name: {name!r}: there is no such region; expected one of: {known}")
        del self.regions[name], self.owners[name]

    def define(self, effect: Effect, owner: int) -> None:
        """Add an effect for its program's lease. Raises ControlError for a name that the run has, and for too many."""
        if effect.name in self._named:
            raise ControlError(f"define.name: {effect.name!r}: the run has such an effect: choose another name")
        if effect.name not in self.effects and len(self._definers) == MOST_DEFINED:
            raise ControlError(f"define.name: {effect.name!r}: there are {MOST_DEFINED} of them: define one anew")
        self.effects[effect.name], self._definers[effect.name] = effect, owner

    def set_settings(self, owner: int, settings: SceneSettings) -> None:
        """Set what a program asks of the whole bar."""
        self._settings[owner] = settings

    def end_lease(self, owner: int) -> None:
        """Drop what a program holds."""
        mine = [name for name, holder in self.owners.items() if holder == owner and not self.regions[name].stays]
        for name in mine:
            self.remove_region(name)
        for name in [name for name, definer in self._definers.items() if definer == owner]:
            del self.effects[name], self._definers[name]
        self._settings.pop(owner, None)

    def is_held_by(self, owner: int) -> bool:
        """Whether something would end with a program's lease."""
        regions = (name for name, holder in self.owners.items() if holder == owner)
        is_holding = owner in self._settings or owner in self._definers.values()
        return is_holding or any(not self.regions[name].stays for name in regions)

    @property
    def settings(self) -> SceneSettings:
        """Settings of all programs together: what one of them switches off is off, and changes of the level add up."""
        each = self._settings.values()
        return SceneSettings(
            all(one.is_enabled for one in each),
            all(one.uses_rule_file for one in each),
            sum(one.level_change_db for one in each),
        )

    def top_region_at(self, position_m: complex, zone: int | None) -> str | None:
        """Name of the region that a finger lies in."""
        for name, region in reversed(self.regions.items()):
            if region.zones is not None:
                if zone in region.zones:
                    return name
            elif region.region_m is not None:
                start_m, stop_m = region.region_m
                if is_within(position_m - start_m, stop_m - start_m):
                    return name
        return None
