"""The scene: regions, effects and settings of all programs, combined with the run's own rules.

The newest region lies on top. Where a region is, neither the regions below it nor the rules of the run hold, not even
for an event that it has no rule for. What a program holds ends with its lease: its settings, its triggered effects, its
quiet fingers, the effects that it defined, and its regions but for those that stay. A program that sets a region or
defines an effect anew takes it over. A region keeps the effects that it was set with, whatever becomes of their names.
"""

from dataclasses import replace

from engine.effects import Effect, Effects, Rule, Trigger
from tactable.control.requests import ControlError, Region, Settings, changed

MOST_REGIONS = 32
MOST_DEFINED = 64
_NOTHING = Effect("nothing", ())


class Scene:
    """What all programs want; `base` are the rules of the run, `named` the effects that every run knows."""

    def __init__(self, base: Effects, named: dict[str, Effect]) -> None:
        self.effects = dict(named)
        """The effects that a message may name."""
        self.regions: dict[str, Region] = {}
        """The lowest first."""
        self.owners: dict[str, int] = {}
        """The program that holds a region; a region that stays has none once that is gone."""
        self._definers: dict[str, int] = {}
        self.base, self._named = base, frozenset(named)
        self._settings: dict[int, Settings] = {}
        self._changed: dict[tuple[Effect, float], Effect] = {}

    def set_region(self, region: Region, owner: int) -> None:
        """Set a region; it keeps its place among the others if it was there. Raises ControlError for too many."""
        if region.name not in self.regions and len(self.regions) == MOST_REGIONS:
            raise ControlError(f"region.name: {region.name!r}: there are {MOST_REGIONS} regions: remove one first")
        self.regions[region.name], self.owners[region.name] = region, owner

    def remove_region(self, name: str) -> None:
        """Remove a region of any program. Raises ControlError where there is none."""
        if name not in self.regions:
            known = ", ".join(self.regions) or "there is none"
            raise ControlError(f"remove.name: {name!r}: there is no such region; expected one of: {known}")
        del self.regions[name], self.owners[name]

    def define(self, effect: Effect, owner: int) -> None:
        """Add an effect, until its program's lease ends.

        Raises ControlError for a name that the run has, and for too many.
        """
        if effect.name in self._named:
            raise ControlError(f"define.name: {effect.name!r}: the run has such an effect: choose another name")
        if effect.name not in self.effects and len(self._definers) == MOST_DEFINED:
            raise ControlError(f"define.name: {effect.name!r}: there are {MOST_DEFINED} of them: define one anew")
        self.effects[effect.name], self._definers[effect.name] = effect, owner

    def set_settings(self, owner: int, settings: Settings) -> None:
        """What a program wants of the whole bar."""
        self._settings[owner] = settings

    def end_lease(self, owner: int) -> bool:
        """Drop what a program holds; whether that were rules."""
        mine = [name for name, holder in self.owners.items() if holder == owner and not self.regions[name].stays]
        for name in mine:
            self.remove_region(name)
        for name in [name for name, definer in self._definers.items() if definer == owner]:
            del self.effects[name], self._definers[name]
        return self._settings.pop(owner, None) is not None or bool(mine)

    @property
    def is_enabled(self) -> bool:
        """Whether no program has switched feeling off."""
        return all(each.is_enabled for each in self._settings.values())

    def rules(self) -> Effects:
        """All of it as rules, the first of which wins."""
        settings = self._settings.values()
        if not self.is_enabled:
            return Effects((), self.base.others)
        change_db = sum(each.level_change_db for each in settings)
        base = self.base.rules if all(each.uses_rule_file for each in settings) else ()
        regions = [*reversed(self.regions.values())]
        triggers = {rule.on for rule in base} | {rule.on for region in regions for rule in region.rules}
        rules = []
        for region in regions:
            own = region.rules if region.is_enabled else ()
            rules += [self._with_levels(rule, change_db + region.level_change_db) for rule in own]
            rules += [_nothing(on, region) for on in Trigger if on in triggers - {rule.on for rule in own}]
        rules += [self._with_levels(rule, change_db) for rule in base]
        return Effects(tuple(rules), self.base.others)

    def top_region_at(self, position_m: float, zone: int | None) -> str | None:
        """Name of the region that a finger lies in."""
        for name, region in reversed(self.regions.items()):
            if region.zones is not None:
                if zone in region.zones:
                    return name
            elif region.region_m is not None and region.region_m[0] <= position_m <= region.region_m[1]:
                return name
        return None

    def _with_levels(self, rule: Rule, change_db: float) -> Rule:
        if not change_db:
            return rule
        key = rule.effect, change_db
        if key not in self._changed:
            if len(self._changed) > MOST_DEFINED * MOST_REGIONS:
                self._changed.clear()
            self._changed[key] = changed(rule.effect, change_db)
        return replace(rule, effect=self._changed[key])


def _nothing(on: Trigger, region: Region) -> Rule:
    """The rule that plays nothing at an event in a region, whatever lies below it."""
    return Rule(on, _NOTHING, region.zones, region.region_m)
