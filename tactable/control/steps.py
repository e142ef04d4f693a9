"""The stated form of control steps, from the control process to the loop: parts of JSON, each of bounded size.

Theory of operation
-------------------
The loop must take a part in less than a millisecond, whatever programs hold, so only what changed crosses, and what is
large crosses in several parts. The encoder remembers what the decoder holds; both number effects and regions.

- `effect`: at most MOST_SEGMENTS segments of an effect, from the segment `at` on. An effect crosses once.
- `region`: the rules of one region, which name effects by their numbers. A region that changes gets another number.
- `scene`: the numbers of the regions, the topmost first, and the settings. Regions that it leaves out are forgotten.
- `act`: the program that is stopped or gone, a role or a trigger.
- `forget`: the number of an effect that nothing names any more.

A part gives the loop a step where it is a scene or an act; the others wait for it in the decoder. The decoder outlives
a run, and its `scene` is what the next run begins with. What does not have the stated form is a StepError.
"""

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from base.errors import TactableError
from base.points import json_of, point_of_json
from engine.effects.rules import ControlStep, Effect, Role, Rule, SceneSettings, Segment, Trigger, TriggeredEffect
from tactable.control.requests import Region, Scene

MOST_BYTES = 8192  # of one part
MOST_SEGMENTS = 128  # of one part
_MOST_NUMBERS = 1024  # effects and regions that the loop may hold; the bounds of a scene are below that
_FULL_SCALE = "full scale"
_NOTHING = Effect("nothing", ())
NOTHING_ASKED = ControlStep()


class StepError(TactableError, ValueError):
    """A part does not have the stated form; the text names the key and the value."""


class StepEncoder:
    """Gives the parts that bring the loop up to a scene, and remembers what it was given."""

    def __init__(self) -> None:
        self._effects: dict[int, tuple[int, Effect]] = {}  # number and effect, by the identity of the effect
        self._regions: dict[int, tuple[int, Region]] = {}
        self._sent: tuple[list[int], SceneSettings] = ([], SceneSettings())

    def parts(self, scene: Scene, act: ControlStep = NOTHING_ASKED) -> Iterator[bytes]:
        """The parts of one step, the scene and what a program asks for beside it: owners, a role or a trigger.

        The loop must take each part before the next is asked for.
        """
        role, trigger = act.role, act.trigger
        regions = [*reversed(scene.regions.values())]
        for effect in (*_effects_of(regions), *([] if trigger is None else [trigger.effect])):
            if id(effect) not in self._effects:
                number = _free(number for number, _ in self._effects.values())
                self._effects[id(effect)] = number, effect
                yield from _parts_of(number, effect)
        for region in regions:
            if id(region) not in self._regions:
                number = _free(number for number, _ in self._regions.values())
                self._regions[id(region)] = number, region
                yield self._region(number, region)
        sent = [self._regions[id(region)][0] for region in regions], scene.settings
        if sent != self._sent:
            self._sent = sent
            self._regions = {id(region): self._regions[id(region)] for region in regions}
            settings = [sent[1].is_enabled, sent[1].uses_rule_file, sent[1].level_change_db]
            yield _encode({"scene": sent[0], "settings": settings})
        asked: dict[str, Any] = {"stopped": act.stopped_owner, "gone": act.gone_owner}
        asked["role"] = None if role is None else [role.contact_id, role.is_quiet, role.owner]
        asked["trigger"] = None if trigger is None else self._trigger(trigger)
        if any(value is not None for value in asked.values()):
            yield _encode({"act": asked})
        kept = {id(effect) for effect in (*scene.effects.values(), *_effects_of(regions))}
        for key in self._effects.keys() - kept:
            yield _encode({"forget": self._effects.pop(key)[0]})

    def _region(self, number: int, region: Region) -> bytes:
        rules = [self._rule(rule) for rule in _rules_of(region)]
        zones = None if region.zones is None else sorted(region.zones)
        corners = None if region.region_m is None else [*map(json_of, region.region_m)]
        place = {"zones": zones, "region_m": corners, "level_change_db": region.level_change_db}
        return _encode({"region": number, "rules": rules, **place})

    def _rule(self, rule: Rule) -> list[Any]:
        along = [json_of(rule.along)] if rule.along else []
        return [rule.on, self._number(rule.effect), rule.after_ns, rule.every_m, *along]

    def _trigger(self, asked: TriggeredEffect) -> list[Any]:
        number = self._number(asked.effect)
        at_m = None if asked.position_m is None else json_of(asked.position_m)
        return [number, asked.owner, asked.contact_id, at_m, asked.level_change_db]

    def _number(self, effect: Effect) -> int:
        return self._effects[id(effect)][0]


class StepDecoder:
    """Gives the step of each part that has one, and holds the effects and regions that parts name."""

    def __init__(self) -> None:
        self.scene = ControlStep((), SceneSettings())  # what programs want of the whole bar now: what a run begins with
        self._effects: dict[int, Effect] = {}
        self._begun: tuple[int, str, list[Segment]] = 0, "", []
        self._regions: dict[int, tuple[Rule, ...]] = {}

    def decode(self, part: bytes | memoryview) -> ControlStep | None:
        """The step of a part; None where later parts are needed. Raises StepError."""
        if len(part) > MOST_BYTES:
            raise StepError(f"a step of a program has {len(part)} bytes; expected at most {MOST_BYTES}")
        try:
            document = json.loads(bytes(part))
            return _READERS[next(iter(document))](self, **document)
        except (ValueError, TypeError, LookupError, AttributeError, StopIteration) as error:
            text = f"a step of a program does not have the stated form ({type(error).__name__}: {error})"
            raise StepError(f"{text}: {bytes(part[:80])!r}") from None

    def take_effect(self, effect: int, name: str, at: int, segments: list[Any], is_whole: bool) -> None:
        """Add segments to the effect that is under way, or begin another one."""
        if at == 0:
            self._begun = _whole(effect, _MOST_NUMBERS), _text(name), []
        number, begun_name, begun = self._begun
        if (number, begun_name, len(begun)) != (effect, name, at) or len(segments) > MOST_SEGMENTS:
            raise ValueError(at)
        begun += map(_segment, segments)
        if is_whole:
            self._effects[number] = Effect(name, tuple(begun))
            self._begun = 0, "", []

    def take_region(
        self, region: int, rules: list[Any], zones: list[int] | None, region_m: list[Any] | None, level_change_db: float
    ) -> None:
        """Add a region, which no scene has yet."""
        indices = None if zones is None else frozenset(_whole(zone, _MOST_NUMBERS) for zone in zones)
        place = indices, None if region_m is None else (point_of_json(region_m[0]), point_of_json(region_m[1]))
        change_db = _number(level_change_db)
        own = [
            replace(rule, along=point_of_json(along[0])) if along else rule
            for on, effect, after, every, *along in rules
            for rule in [Rule(Trigger(on), self._effects[effect], *place, _whole(after), _number(every), change_db)]
        ]
        # Neither regions below nor the rules of the run hold here, not even for an event without a rule.
        others = [Rule(on, _NOTHING, *place) for on in Trigger if all(rule.on is not on for rule in own)]
        self._regions[_whole(region, _MOST_NUMBERS)] = (*own, *others)

    def take_scene(self, scene: list[int], settings: list[Any]) -> ControlStep:
        """The rules of these regions, the topmost first, and the settings."""
        is_enabled, uses_rule_file, change_db = settings
        self._regions = {number: self._regions[number] for number in scene}
        rules = tuple(rule for region in self._regions.values() for rule in region)
        self.scene = ControlStep(rules, SceneSettings(_flag(is_enabled), _flag(uses_rule_file), _number(change_db)))
        return self.scene

    def take_act(self, act: dict[str, Any]) -> ControlStep:
        """Take a request of a program that does not change the scene."""
        role, trigger, programs = act["role"], act["trigger"], (act["stopped"], act["gone"])
        stopped, gone = (None if each is None else _whole(each) for each in programs)
        return ControlStep(
            stopped_owner=stopped,
            gone_owner=gone,
            role=None if role is None else Role(_whole(role[0]), _flag(role[1]), _whole(role[2])),
            trigger=None if trigger is None else self._triggered(*trigger),
        )

    def _triggered(
        self, effect: int, owner: int, contact_id: int | None, position_m: Any, level_change_db: float
    ) -> TriggeredEffect:
        if (contact_id is None) is (position_m is None):
            raise ValueError(contact_id)
        finger = None if contact_id is None else _whole(contact_id)
        place_m = None if position_m is None else point_of_json(position_m)
        return TriggeredEffect(self._effects[effect], _whole(owner), finger, place_m, _number(level_change_db))

    def forget(self, forget: int) -> None:
        """Drop an effect that nothing names any more."""
        del self._effects[forget]


_READERS: Mapping[str, Callable[..., ControlStep | None]] = {
    "effect": StepDecoder.take_effect,
    "region": StepDecoder.take_region,
    "scene": StepDecoder.take_scene,
    "act": StepDecoder.take_act,
    "forget": StepDecoder.forget,
}


def _rules_of(region: Region) -> tuple[Rule, ...]:
    return region.rules if region.is_enabled else ()


def _effects_of(regions: Iterable[Region]) -> list[Effect]:
    return [rule.effect for region in regions for rule in _rules_of(region)]


def _free(taken: Iterable[int]) -> int:
    """The lowest number that is not taken."""
    used = set(taken)
    return next(number for number in range(len(used) + 1) if number not in used)


def _parts_of(number: int, effect: Effect) -> Iterator[bytes]:
    envelope = effect.envelope
    for at in range(0, max(1, len(envelope)), MOST_SEGMENTS):
        stop = at + MOST_SEGMENTS
        levels = [_FULL_SCALE if each.level_db == math.inf else each.level_db for each in envelope[at:stop]]
        segments = [[s.duration_ns, level, s.is_click] for s, level in zip(envelope[at:stop], levels, strict=True)]
        whole = stop >= len(envelope)
        yield _encode({"effect": number, "name": effect.name, "at": at, "segments": segments, "is_whole": whole})


def _encode(document: dict[str, Any]) -> bytes:
    return json.dumps(document, allow_nan=False, separators=(",", ":")).encode()


def _segment(values: Sequence[Any]) -> Segment:
    duration_ns, level_db, is_click = values
    level = math.inf if level_db == _FULL_SCALE else None if level_db is None else _number(level_db)
    return Segment(None if duration_ns is None else _whole(duration_ns), level, _flag(is_click))


def _whole(value: Any, stop: int = 1 << 63) -> int:
    if type(value) is not int or not 0 <= value < stop:
        raise ValueError(value)
    return value


def _number(value: Any) -> float:
    if type(value) not in (int, float) or not math.isfinite(value):
        raise ValueError(value)
    return float(value)


def _flag(value: Any) -> bool:
    if type(value) is not bool:
        raise ValueError(value)
    return value


def _text(value: Any) -> str:
    if type(value) is not str:
        raise ValueError(value)
    return value
