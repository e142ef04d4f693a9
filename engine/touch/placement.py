"""A placement: the fingers on the bar, each at its position and with its role; what drives and clicks are made for."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite
from typing import TYPE_CHECKING

from base.errors import TactableError
from engine.touch.finger_tracker import ZoneEdges, ZoneState

if TYPE_CHECKING:
    from engine.device import Device

MOST_FINGERS = 10  # two hands
CLOSEST_M = 8e-3
"""Distance below which two fingers are one to the bar: a fingertip is wider, and their motions are nearly the same."""
_ROUNDING_M = 1e-9


class PlacementError(TactableError, ValueError):
    """Fingers that no bar can tell apart or that do not lie on it; the message names them and the remedy."""


@dataclass(frozen=True, order=True)
class Placement:
    """Positions of the fingers in metres from the start of the bar, rising, and whether each of them feels."""

    position_m: tuple[float, ...]
    is_felt: tuple[bool, ...]

    @classmethod
    def on(cls, device: "Device", felt_m: Sequence[float], quiet_m: Sequence[float] = ()) -> "Placement":
        """Fingers on the bar of a device, in any order.

        Raises PlacementError for no or more than MOST_FINGERS fingers, one beside the bar, and two closer together
        than CLOSEST_M.
        """
        fingers = sorted([(at_m, True) for at_m in felt_m] + [(at_m, False) for at_m in quiet_m])
        if not 1 <= len(fingers) <= MOST_FINGERS:
            raise PlacementError(f"{len(fingers)} fingers: give 1 to {MOST_FINGERS}")
        length_m = device.bar.length_m
        for at_m, _ in fingers:
            if not isfinite(at_m) or not 0 <= at_m <= length_m:
                raise PlacementError(
                    f"a finger at {1e3 * at_m:g} mm: {device.name} reaches from 0 to {1e3 * length_m:g} mm"
                )
        for (one_m, _), (next_m, _) in pairwise(fingers):
            if next_m - one_m < CLOSEST_M - _ROUNDING_M:
                raise PlacementError(
                    f"fingers at {1e3 * one_m:g} and {1e3 * next_m:g} mm: closer than {1e3 * CLOSEST_M:g} mm they are "
                    "one finger to the bar: give one of them"
                )
        return cls(tuple(at_m for at_m, _ in fingers), tuple(is_felt for _, is_felt in fingers))

    @classmethod
    def named(cls, device: "Device", felt: Sequence[str | float], quiet: Sequence[str | float] = ()) -> "Placement":
        """Fingers at positions, each a text with a unit, a number of metres, or a zone's name, which means its middle.

        Raises PlacementError as `on`, and for a text that is neither a length nor a zone.

        >>> Placement.named(device, felt=["35 mm"], quiet=["IV", 0.16])
        """
        return cls.on(device, _positions_m(device, felt), _positions_m(device, quiet))

    @classmethod
    def in_zones(cls, device: "Device", states: Sequence[ZoneState]) -> "Placement":
        """A finger in the middle of every zone that is not free."""
        touched = [
            (zone, state) for zone, state in zip(device.zones, states, strict=True) if state is not ZoneState.FREE
        ]
        return cls(
            tuple((zone.start_m + zone.stop_m) / 2 for zone, _ in touched),
            tuple(state is ZoneState.FELT for _, state in touched),
        )

    def zone_states(self, device: "Device") -> tuple[ZoneState, ...]:
        """State of every zone: FELT where one of its fingers feels, else QUIET where one rests."""
        edges, states = ZoneEdges(device), [ZoneState.FREE] * len(device.zones)
        for at_m, is_felt in zip(self.position_m, self.is_felt, strict=True):
            zone = edges.zone_at(at_m)
            if zone is not None:
                states[zone] = max(states[zone], ZoneState.FELT if is_felt else ZoneState.QUIET)
        return tuple(states)

    @property
    def felt(self) -> list[int]:
        """Indices of the fingers that feel."""
        return [finger for finger, is_felt in enumerate(self.is_felt) if is_felt]

    @property
    def quiet(self) -> list[int]:
        """Indices of the fingers that are to feel nothing."""
        return [finger for finger, is_felt in enumerate(self.is_felt) if not is_felt]


def merged(fingers: Iterable[tuple[float, bool]]) -> tuple[tuple[float, ...], tuple[bool, ...], int]:
    """Fingers (position in metres, whether it feels) in rising order, those that are one to the bar joined.

    Returns positions, roles, and how many fingers were joined to their lower neighbour. Two fingers closer than
    CLOSEST_M are one, which feels if either does; it lies where the felt one lies, else where the lower one does.
    """
    position_m, is_felt, joined = list[float](), list[bool](), 0
    for at_m, feels in sorted(fingers):
        if position_m and at_m - position_m[-1] < CLOSEST_M - _ROUNDING_M:
            joined += 1
            if feels and not is_felt[-1]:
                position_m[-1], is_felt[-1] = at_m, True
            continue
        position_m.append(at_m)
        is_felt.append(feels)
    return tuple(position_m), tuple(is_felt), joined


def _positions_m(device: "Device", named: Sequence[str | float]) -> list[float]:
    from engine.device.quantity import QuantityError, read_quantity

    if isinstance(named, str):
        raise PlacementError(f"fingers {named!r}: is one text; give a list, such as [{named!r}]")
    middle_m = {zone.name: (zone.start_m + zone.stop_m) / 2 for zone in device.zones}
    found_m = list[float]()
    for each in named:
        if not isinstance(each, str):
            found_m.append(float(each))
        elif each in middle_m:
            found_m.append(middle_m[each])
        else:
            try:
                found_m.append(read_quantity(each, "m"))
            except QuantityError as error:
                raise PlacementError(f"{error}; or one of the zones {', '.join(middle_m)}") from None
    return found_m
