"""Reads rule files and the vocabulary in TOML (tables/EFFECTS.md); errors name key, value and what was expected."""

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

from engine.device import Device
from engine.device.parts import Bar
from engine.device.toml_table import HIGHEST_LEVEL_DB, TomlTable, read_text
from engine.effects.files.conversion import FULL_LEVEL_DB, MOST_SEGMENTS, Converted, Fate, read_effect_file
from engine.effects.rules import FULL_SCALE_DB, Drives, Effect, EffectError, Effects, Rule, Segment, Trigger

CLICK, HELD, FULL_SCALE, QUIET = "click", "held", "full scale", "quiet"
NO_EFFECTS: Mapping[str, Effect] = MappingProxyType({})
MOST_RULES = 256  # the loop looks for a finger's rule in all of them at each event
_SHORTEST_S, _LEAST_TRAVEL_M = 1e-3, 1e-4  # finer than any digitizer reports


class RuleTable(TomlTable):
    """A table of a rule file; its errors are EffectErrors."""

    family = EffectError


def read_effects(
    path: Path, device: Device, named: Mapping[str, Effect] = NO_EFFECTS, tell: Callable[[str], None] = lambda _: None
) -> Effects:
    """Read and validate a rule file for a device, whose zones it names. Raises EffectError; OSError without a file.

    `named` are effects that its rules may name beside its own; an effect of the file replaces one of the same name.
    `tell` gets a line for each effect file of which not every event is played.
    """
    return parse_effects(read_text(path, EffectError), str(path), device, named, path.parent, tell)


def parse_effects(
    text: str,
    source: str,
    device: Device,
    named: Mapping[str, Effect] = NO_EFFECTS,
    folder: Path | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> Effects:
    """The rules in `text` of `source`; effect files are looked up in `folder`, if any. Raises EffectError."""
    top = RuleTable.parse(text, source)
    parts = top.tables("effect") if top.has("effect") else []
    rule_parts = top.tables("rule")
    if len(rule_parts) > MOST_RULES:
        raise top.error("rule", len(rule_parts), f"expected at most {MOST_RULES} rules")
    drives = Drives(top.word("drives", tuple(Drives), Drives.POSITIONS))
    top.refuse_rest()
    effects = {**named, **_read_effects(parts, folder, tell)}
    return Effects(tuple(read_rule(part, effects, device) for part in rule_parts), drives=drives)


def read_vocabulary(path: Path) -> dict[str, Effect]:
    """Read a file of effects without rules, by name. Raises EffectError; OSError without a file."""
    top = RuleTable.parse(read_text(path, EffectError), str(path))
    effects = _read_effects(top.tables("effect"), path.parent, lambda _: None)
    top.refuse_rest()
    return effects


def _read_effects(parts: list[RuleTable], folder: Path | None, tell: Callable[[str], None]) -> dict[str, Effect]:
    effects: dict[str, Effect] = {}
    for part in parts:
        name = part.name("name")
        if "file" in part.left:
            effect = _effect_of_file(part, name, folder, tell)
        else:
            effect = Effect(name, read_envelope(part))
            part.known += ["file", "level"]
        if effect.name in effects:
            raise part.error("name", effect.name, "another effect has this name")
        effects[effect.name] = effect
        part.refuse_rest()
    return effects


def _effect_of_file(part: RuleTable, name: str, folder: Path | None, tell: Callable[[str], None]) -> Effect:
    """The effect of the keys `file` and `level`, in place of an envelope."""
    file_name = part.take_value("file")
    level_db = part.level_db("level", part.take_value("level", f"{FULL_LEVEL_DB:g} dB"))
    if not isinstance(file_name, str) or folder is None:
        raise part.error("file", file_name, "expected the name of an effect file beside this rule file")
    try:
        converted = read_effect_file(folder / file_name, name, level_db)
    except OSError as error:
        raise part.error("file", file_name, f"an effect file that can be read ({error.strerror})") from None
    if converted.number(Fate.KEPT) < len(converted.reports):
        tell(loss_text(converted, folder / file_name))
    return converted.effect


def loss_text(converted: Converted, path: Path) -> str:
    """One line that says how much of an effect file is played."""
    return f"effect {converted.name}: {converted.summary} (`tactable effects show {path}` says which)"


def read_envelope(part: RuleTable) -> tuple[Segment, ...]:
    """The segments of the key `envelope`."""
    pairs = part.take_value("envelope")
    if not isinstance(pairs, list) or not pairs:
        raise part.error("envelope", pairs, 'expected a list of segments: [["click", "20 dB"]] or [["50 ms", "20 dB"]]')
    if len(pairs) > MOST_SEGMENTS:
        raise part.error("envelope", len(pairs), f"expected at most {MOST_SEGMENTS} segments")
    segments = tuple(_read_segment(part, pair) for pair in pairs)
    if any(segment.duration_ns is None and not segment.is_click for segment in segments[:-1]):
        raise part.error("envelope", pairs, f"only the last segment may be {HELD!r}: nothing comes after it")
    return segments


def _read_segment(part: RuleTable, pair: object) -> Segment:
    if not isinstance(pair, list) or len(pair) != 2:
        raise part.error("envelope", pair, 'expected a duration and a level: ["click", "20 dB"] or ["50 ms", "20 dB"]')
    duration, level = pair
    if duration == CLICK:
        if level == QUIET:
            raise part.error("envelope", pair, "a click is felt: give it a level, or the pause a duration")
        return Segment(None, _read_level(part, level), is_click=True)
    if duration == HELD:
        return Segment(None, _read_level(part, level))
    duration_s = part.checked("envelope", duration, "s", least=_SHORTEST_S)
    return Segment(round(1e9 * duration_s), _read_level(part, level))


def _read_level(part: RuleTable, text: object) -> float | None:
    if text == QUIET:
        return None
    if text == FULL_SCALE:
        return FULL_SCALE_DB
    if not isinstance(text, str) or not text.endswith("dB"):
        levels = f"0 to {HIGHEST_LEVEL_DB:g} dB above threshold such as '20 dB', {FULL_SCALE!r} or {QUIET!r}"
        raise part.error("envelope", text, f"expected {levels}")
    return part.level_db("envelope", text)


def read_rule(part: RuleTable, effects: Mapping[str, Effect], device: Device) -> Rule:
    """A rule, whose effect is one of `effects`."""
    on = Trigger(part.word("on", tuple(Trigger)))
    effect = effects[part.word("effect", tuple(effects))]
    if on is Trigger.LIFT and effect.is_endless:
        held = f"its envelope ends with {HELD!r}, but a finger that has left holds nothing: give it a duration"
        raise part.error("effect", effect.name, held)
    zones, region_m = read_place(part, device)
    rule = Rule(
        on,
        effect,
        zones,
        region_m,
        after_ns=round(1e9 * part.quantity("after", "s", least=_SHORTEST_S)) if on is Trigger.HOLD else 0,
        every_m=part.quantity("every", "m", least=_LEAST_TRAVEL_M) if on is Trigger.DRAG else 0.0,
        along=_read_direction(part) if on is Trigger.DRAG and not isinstance(device.surface, Bar) else 0.0,
    )
    part.refuse_rest()
    return rule


def _read_direction(part: RuleTable) -> complex:
    """Direction of a drag on a plate: along its length (x), across it (y), or any."""
    return {"x": 1.0, "y": 1j, "any": 0.0}[part.word("along", ("x", "y", "any"), "any")]


def read_place(part: RuleTable, device: Device) -> tuple[frozenset[int] | None, tuple[complex, complex] | None]:
    """Zones, or first and last corner of a region in metres, or neither: everywhere."""
    if part.has("zones") & part.has("region"):
        raise part.error("region", part.left["region"], "give either zones or a region")
    zones = _read_zones(part, device) if "zones" in part.left else None
    return zones, _read_region(part, device) if "region" in part.left else None


def _read_zones(part: RuleTable, device: Device) -> frozenset[int]:
    names = part.left.pop("zones")
    if not isinstance(names, list) or not names:
        raise part.error("zones", names, "expected a list of zones such as ['I', 'III']; without the key: everywhere")
    known = [zone.name for zone in device.zones]
    for name in names:
        if name not in known:
            raise part.error("zones", name, f"{device.name} has no such zone; its zones are {', '.join(known)}")
    return frozenset(map(known.index, names))


def _read_region(part: RuleTable, device: Device) -> tuple[complex, complex]:
    ends = part.left.pop("region")
    if not isinstance(ends, list) or len(ends) != 2:
        raise part.error("region", ends, "expected two positions such as ['40 mm', '60 %']")
    start_m, stop_m = (part.checked_point("region", text, device.surface.corner_m) for text in ends)
    span_m = stop_m - start_m
    if span_m.real <= 0 or (isinstance(span_m, complex) and span_m.imag <= 0):
        raise part.error("region", ends, "is empty: the first position must be before the second")
    return start_m, stop_m
