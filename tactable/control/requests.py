"""Messages of programs to requests: lines of JSON, checked key by key (tables/schemas/control.schema.json).

Quantities carry units and rules have the keys of rule files, so that both are learnt once. A wrong message is refused
by a ControlError, whose text names the key, its value and what was expected. `Scene` keeps what programs asked for.
"""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from base.errors import TactableError
from base.points import is_within
from engine.device import Device
from engine.device.toml_table import HIGHEST_LEVEL_DB
from engine.effects.files.conversion import FORMATS, FULL_LEVEL_DB, Converted, decode_effect_file
from engine.effects.files.json_part import Part, read_json
from engine.effects.rule_file import RuleTable, read_envelope, read_place, read_rule
from engine.effects.rules import Effect, EffectError, Role, Rule, SceneSettings, TriggeredEffect

VERSION = 1  # version of the messages; `hello` states it
MOST_BYTES = 16_384  # limit of a line
MOST_SEGMENTS = 16
MOST_RULES = 8  # the most rules of one region
MOST_REGIONS = 32  # with 8 rules each; docs/programs.md has the time of a change beside them
MOST_DEFINED = 64  # of 16 segments at most: bounds the memory of a run
GREATEST_ID = (1 << 53) - 1  # the greatest integer that every JSON reader keeps exact (RFC 8259, 6)
DEFAULT_LEASE_S, SHORTEST_LEASE_S, LONGEST_LEASE_S = 5.0, 0.1, 3600.0  # of a program that hangs, what it held ends
STREAMS = ("touches", "played")


class ControlError(TactableError, ValueError):
    """A message that is refused; the text names key, value and what was expected."""


@dataclass(frozen=True)
class Hello:
    """The first message: who speaks, and for how long what it holds outlasts its silence."""

    name: str
    lease_s: float


@dataclass(frozen=True)
class Region:
    """A stretch of the bar or some zones, with rules in place of those of the rule file."""

    name: str
    rules: tuple[Rule, ...]  # without the place and the change of level, which are the region's
    zones: frozenset[int] | None
    region_m: tuple[complex, complex] | None
    is_enabled: bool  # False: no event in it is felt; programs may trigger effects there all the same
    level_change_db: float
    stays: bool  # it outlasts the program's lease


@dataclass(frozen=True)
class RemoveRegion:
    """A region ends."""

    name: str


@dataclass(frozen=True)
class DefineEffect:
    """An effect that later messages of all programs may name, until the program's lease ends."""

    effect: Effect
    converted: Converted | None = None  # what became of the events, where it came as an effect file


@dataclass(frozen=True)
class StopRequest:
    """End all effects that the program triggered."""


@dataclass(frozen=True)
class Subscribe:
    """The streams of events that the program gets from now on."""

    streams: frozenset[str]


@dataclass(frozen=True)
class Ping:
    """A message that only renews the lease."""


_Wish = Region | RemoveRegion | DefineEffect | SceneSettings | TriggeredEffect | StopRequest | Role  # of a program
Request = Hello | _Wish | Subscribe | Ping


def decode_line(line: bytes) -> tuple[int | None, dict[str, Any]]:
    """The id of a message, None without one, and its other keys. Raises ControlError for what is no message."""
    if len(line) > MOST_BYTES:
        raise ControlError(f"message: {len(line)} bytes; expected at most {MOST_BYTES}: send it in parts")
    try:
        values = read_json(line)
    except (ValueError, RecursionError) as error:
        raise ControlError(f"message: not JSON: {error}; expected one object a line") from None
    if not isinstance(values, dict):
        raise ControlError(f"message: {type(values).__name__}; expected an object with the key 'type'")
    number = values.pop("id", None)
    if number is not None and (type(number) is not int or not 0 <= number <= GREATEST_ID):
        raise ControlError(f"id: {number!r:.40}: expected a whole number from 0 to {GREATEST_ID}")
    return number, values


def read_request(values: Mapping[str, Any], device: Device, effects: Mapping[str, Effect], owner: int) -> Request:
    """The request of the program `owner` in a message; `effects` are those it may name. Raises ControlError."""
    part = RuleTable("message", "", dict(values))
    try:
        part.path = kind = part.word("type", tuple(_READERS))
        request = _READERS[kind](part, device, effects, owner)
        part.refuse_rest()
    except EffectError as error:
        raise ControlError(str(error)) from None
    return request


def _read_hello(part: RuleTable, *_: object) -> Hello:
    version = part.integer("version", 1, 1 << 31)
    if version != VERSION:
        raise part.error("version", version, f"this run speaks version {VERSION}: use a client of that version")
    lease_s = part.quantity("lease", "s", least=SHORTEST_LEASE_S, default=f"{DEFAULT_LEASE_S} s")
    if lease_s > LONGEST_LEASE_S:
        raise part.error("lease", f"{lease_s:g} s", f"expected at most {LONGEST_LEASE_S:g} s")
    return Hello(part.name("name"), lease_s)


def _read_region(part: RuleTable, device: Device, effects: Mapping[str, Effect], _owner: int) -> Region:
    name = part.name("name")
    zones, region_m = read_place(part, device)
    if zones is None and region_m is None:
        raise part.error("region", None, "expected two positions such as ['40 mm', '60 %'], or 'zones'")
    tables = part.take_value("rules")
    if not isinstance(tables, list) or not 1 <= len(tables) <= MOST_RULES:
        raise part.error("rules", tables, f"expected 1 to {MOST_RULES} rules, each with 'on' and 'effect'")
    rules = []
    for number, table in enumerate(tables):
        rule = read_rule(RuleTable(part.source, f"region.rules[{number}]", table), effects, device)
        if rule.zones is not None or rule.region_m is not None:
            raise part.error("rules", table, "the place is the region's: leave 'zones' and 'region' out of its rules")
        rules.append(rule)
    is_enabled, stays = part.flag("enabled", True), part.flag("stays", False)
    return Region(name, tuple(rules), zones, region_m, is_enabled, _read_change(part), stays)


def _read_define(part: RuleTable, *_: object) -> DefineEffect:
    name = part.name("name")
    if "format" in part.left:
        return _read_effect_file(part, name)
    effect = Effect(name, read_envelope(part))
    part.known += ["format", "content", "level"]
    if len(effect.envelope) > MOST_SEGMENTS:
        raise part.error("envelope", len(effect.envelope), f"expected at most {MOST_SEGMENTS} segments")
    return DefineEffect(effect)


def _read_effect_file(part: RuleTable, name: str) -> DefineEffect:
    """An effect whose content is that of an effect file, in place of an envelope."""
    file_format = part.word("format", tuple(FORMATS))
    level_db = part.level_db("level", part.take_value("level", f"{FULL_LEVEL_DB:g} dB"))
    converted = decode_effect_file(Part("define.content", "", part.take_value("content")), file_format, name, level_db)
    return DefineEffect(converted.effect, converted)


def _read_trigger(part: RuleTable, device: Device, effects: Mapping[str, Effect], owner: int) -> TriggeredEffect:
    effect = effects[part.word("effect", tuple(effects))]
    change_db = _read_change(part)
    if ("finger" in part.left) == ("at" in part.left):
        raise part.error("finger", part.left.get("finger"), "give either a finger or 'at', a place such as '40 mm'")
    if "finger" in part.left:
        return TriggeredEffect(effect, owner, part.integer("finger", 0, GREATEST_ID), None, change_db)
    if effect.is_endless:
        raise part.error("effect", effect.name, "is held, but at a place no finger holds it: give a finger")
    return TriggeredEffect(effect, owner, None, part.point("at", device.surface.corner_m), change_db)


def _read_subscribe(part: RuleTable, *_: object) -> Subscribe:
    streams = part.take_value("to")
    if not isinstance(streams, list) or any(each not in STREAMS for each in streams):
        raise part.error("to", streams, f"expected a list of {', '.join(STREAMS)}; empty: no events")
    return Subscribe(frozenset(streams))


_READERS: Mapping[str, Callable[[RuleTable, Device, Mapping[str, Effect], int], Request]] = {
    "hello": _read_hello,
    "region": _read_region,
    "remove": lambda part, *_: RemoveRegion(part.name("name")),
    "define": _read_define,
    "settings": lambda part, *_: SceneSettings(
        part.flag("enabled", True), part.flag("rule_file", True), _read_change(part)
    ),
    "trigger": _read_trigger,
    "stop": lambda *_: StopRequest(),
    "role": lambda part, _device, _effects, owner: Role(
        part.integer("finger", 0, GREATEST_ID), part.word("role", ("quiet", "by rules")) == "quiet", owner
    ),
    "subscribe": _read_subscribe,
    "ping": lambda *_: Ping(),
}


def _read_change(part: RuleTable) -> float:
    """A change of levels such as "-6 dB"."""
    text = part.take_value("level_change", "0 dB")
    match = re.fullmatch(r"([+-]?[0-9]+(?:\.[0-9]*)?) ?dB", text) if isinstance(text, str) else None
    change_db = float(match[1]) if match is not None else math.nan
    if not abs(change_db) <= HIGHEST_LEVEL_DB:
        raise part.error("level_change", text, f"expected -{HIGHEST_LEVEL_DB:g} to {HIGHEST_LEVEL_DB:g} dB: '-6 dB'")
    return change_db


class Scene:
    """What all programs want, which the loop puts above the run's own rules; `named` are the effects of every run.

    The newest region lies on top. Where a region is, neither the regions below it nor the rules of the run hold, not
    even for an event that it has no rule for. What a program holds ends with its lease: its settings, its triggered
    effects, its quiet fingers, the effects that it defined, and its regions but for those that stay. A program that
    sets a region or defines an effect again takes it over. A region keeps the effects that it was set with, whatever
    becomes of their names.
    """

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
