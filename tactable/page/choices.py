"""The switches of the page: their positions, and the effect rules that follow from them."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

from base.errors import TactableError
from base.plain import to_plain
from base.points import point_of_json
from engine.device import Device
from engine.effects.rule_file import read_effects
from engine.effects.rules import FULL_SCALE_DB, Drives, Effect, Effects, Rule, Segment, Trigger
from engine.table.levels import DEFAULT_LEVEL_DB
from tactable.shipped import named_effects, shipped_names

DRAG_STEP_M = 0.01  # as tables/effects/slider.toml
_FINEST_M, _FARTHEST_M = 1e-5, 100.0  # smaller moves of an actuator are ignored
HOLD_NS = 500_000_000  # the long press of iOS
_NOTHING = Effect("nothing", (Segment(None, None),))


class ChoiceError(TactableError, ValueError):
    """An unknown switch, or a position that the switch does not have; the message lists the valid ones."""


class Source(StrEnum):
    """The kind of drive that plays."""

    CLICK = "click"  # the click for the fingers
    STEADY = "steady"  # the steady drive for the fingers, as long as one touches that is to feel
    ZONES = "zones"  # the row of the sweep for the zones of the fingers, likewise: the published method


class Rules(StrEnum):
    """The event at which a finger feels."""

    TOUCH = "touch"
    HOLD = "hold"
    DRAG = "drag"
    LIFT = "lift"
    FILE = "file"  # taken from a rule file, which then decides about levels, clicks and quiet zones


@dataclass(frozen=True)
class Choice:
    """The position of every switch. Of its plain values (`to_plain`) a level of None is full scale.

    quiet_zones: names of zones where a finger never feels. actuators_m (actuator,): where the actuators would be, none
    for where the device file has them.
    """

    device: str
    source: Source = Source.CLICK
    rules: Rules = Rules.TOUCH
    level_db: float = DEFAULT_LEVEL_DB
    quiet_zones: tuple[str, ...] = ()
    is_loaded: bool = True  # whether the fingers load the simulated bar
    is_other: bool = False
    """Whether the simulated bar is another one than the table's, with other fingers, beside where they seem to be."""
    actuators_m: tuple[complex, ...] = ()


@dataclass(frozen=True)
class Offered:
    """The positions on offer; `rule_file` was given on the command line."""

    devices: tuple[str, ...]
    rule_file: Path | None = None

    @property
    def rules(self) -> tuple[Rules, ...]:
        """All rules; those of the file only where there is one."""
        return tuple(rules for rules in Rules if rules is not Rules.FILE or self.rule_file is not None)


def offered(device_name: str, rule_file: Path | None = None) -> Offered:
    """The shipped devices, and `device_name` where it is another one."""
    return Offered(tuple(dict.fromkeys((device_name, *shipped_names()))), rule_file)


def of_device(choice: Choice, name: str) -> Choice:
    """The choice for another device: its zones and its actuators are others."""
    return replace(choice, device=name, quiet_zones=(), actuators_m=())


def changed(choice: Choice, switches: Mapping[str, Any], device: Device, offers: Offered) -> Choice:
    """The choice after these switches moved, of the device as its file has it. Raises ChoiceError.

    Another device starts without quiet zones, its actuators where they are.
    """
    for name, value in switches.items():
        choice = _moved(choice, name, value, device, offers)
    return choice


def _moved(choice: Choice, name: str, value: Any, device: Device, offers: Offered) -> Choice:
    match name:
        case "device":
            other: str = _one_of(name, value, offers.devices)
            if other == choice.device:
                return choice
            return of_device(choice, other)
        case "source":
            return replace(choice, source=Source(_one_of(name, value, tuple(Source))))
        case "rules":
            return replace(choice, rules=Rules(_one_of(name, value, offers.rules)))
        case "level_db":
            levels = (*device.levels_db, None)
            level = _one_of(name, value, levels)
            return replace(choice, level_db=FULL_SCALE_DB if level is None else level)
        case "quiet_zones":
            names = tuple(zone.name for zone in device.zones)
            if not isinstance(value, list):
                raise ChoiceError(f"quiet_zones is {value!r}; expected a list of zones")
            return replace(choice, quiet_zones=tuple(dict.fromkeys(_one_of(name, each, names) for each in value)))
        case "actuators_m":
            count = len(device.actuators)
            kind = type(device.surface.corner_m)
            places: list[Any] = [_point(each) for each in value] if isinstance(value, list) else [None]
            if len(places) not in (0, count) or not all(isinstance(at_m, kind) for at_m in places):
                raise ChoiceError(f"actuators_m is {value!r}; expected {count} positions in metres, or none")
            return replace(choice, actuators_m=tuple(places))
        case "is_loaded" | "is_other":
            return replace(choice, **{name: _one_of(name, value, (True, False))})
    raise ChoiceError(f"there is no switch {name!r}; there are {', '.join(to_plain(Choice('')))}")


def _point(value: Any) -> Any:
    """The point of a JSON value; None where it is not a point, or is unbelievably far away."""
    try:
        point = point_of_json(value)
        return point if abs(point) < _FARTHEST_M else None
    except (ValueError, OverflowError):
        return None


def moved(device: Device, choice: Choice) -> Device:
    """The device with its actuators where the choice has them. Raises DeviceError for a place beside its surface."""
    if not choice.actuators_m:
        return device
    pairs = zip(choice.actuators_m, device.actuators, strict=True)
    return device.with_values(
        {
            f"actuator[{number}].position": _words(at_m)
            for number, (at_m, actuator) in enumerate(pairs, 1)
            if abs(at_m - actuator.position_m) >= _FINEST_M
        }
    )


def _words(at_m: complex) -> str | list[str]:
    """A position as a device file has it."""
    along, across = (f"{1e3 * side_m:.2f} mm" for side_m in (at_m.real, at_m.imag))
    return [along, across] if isinstance(at_m, complex) else along


def _one_of(name: str, value: Any, positions: tuple[Any, ...]) -> Any:
    for position in positions:
        # True is 1 to Python.
        if position == value and isinstance(position, bool) == isinstance(value, bool):
            return position
    raise ChoiceError(f"{name} is {value!r}; expected one of {', '.join(map(str, positions))}")


def effects_of(choice: Choice, device: Device, rule_file: Path | None) -> Effects:
    """The rules of a choice. Raises EffectError where its file does not suit the device; OSError without it."""
    if choice.rules is Rules.FILE and rule_file is not None:
        return read_effects(rule_file, device, named_effects())
    is_click = choice.source is Source.CLICK
    feel = Effect("feel", (_segment(choice, is_click),))
    on = Trigger(choice.rules.value)
    quiet = frozenset(device.zone_index(name) for name in choice.quiet_zones)
    rules = [_rule(on, _NOTHING, quiet)] if quiet else []
    drives = Drives.ZONES if choice.source is Source.ZONES else Drives.POSITIONS
    return Effects((*rules, _rule(on, feel, None)), drives=drives)


def _rule(on: Trigger, effect: Effect, zones: frozenset[int] | None) -> Rule:
    after_ns, every_m = HOLD_NS if on is Trigger.HOLD else 0, DRAG_STEP_M if on is Trigger.DRAG else 0.0
    return Rule(on, effect, zones, after_ns=after_ns, every_m=every_m)


def _segment(choice: Choice, is_click: bool) -> Segment:
    """The segment of the effect; a lifted finger holds nothing, so its steady effect has a duration."""
    if choice.rules is Rules.LIFT and not is_click:
        return Segment(HOLD_NS, choice.level_db)
    return Segment(None, choice.level_db, is_click=is_click)
