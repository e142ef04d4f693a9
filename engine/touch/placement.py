"""A placement: the fingers on the surface, each at its point and with its role; what drives and clicks are made for.

Places are an even grid over the surface, whose points the tabulated clicks are made for. A finger belongs to the
nearest place. The fingers of a placement, each as the number 2 * place + 1 where it feels and 2 * place where it is
quiet, in rising order, are the key of a click.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import TYPE_CHECKING

from base.errors import TactableError
from base.points import is_within, order_of, point_text
from engine.touch.finger_tracker import ZoneFinder, ZoneState

if TYPE_CHECKING:
    from engine.device import Device

MOST_FINGERS = 10  # two hands
CLOSEST_M = 8e-3  # below it two fingers are one to the surface: a fingertip is wider, and they move alike
_ROUNDING_M = 1e-9
Key = tuple[int, ...]  # 2 * place + is_felt of each finger, rising
_ROUNDING = 1e-9


class PlacementError(TactableError, ValueError):
    """Fingers that no surface can tell apart or that do not lie on it; the message names them and the remedy."""


@dataclass(frozen=True)
class Placement:
    """Points of the fingers in metres (base.points), rising along the surface, and whether each of them feels.

    Fingers of a plate that lie at the same height along it rise across it.
    """

    position_m: tuple[complex, ...]
    is_felt: tuple[bool, ...]

    @classmethod
    def on(cls, device: "Device", felt_m: Sequence[complex], quiet_m: Sequence[complex] = ()) -> "Placement":
        """Fingers on the surface of a device, in any order.

        Raises PlacementError for no or more than MOST_FINGERS fingers, one beside the surface, and two closer together
        than CLOSEST_M.
        """
        fingers = _sorted([(at_m, True) for at_m in felt_m] + [(at_m, False) for at_m in quiet_m])
        if not 1 <= len(fingers) <= MOST_FINGERS:
            raise PlacementError(f"{len(fingers)} fingers: give 1 to {MOST_FINGERS}")
        corner_m = device.surface.corner_m
        for at_m, _ in fingers:
            if isinstance(at_m, complex) is not isinstance(corner_m, complex) or not is_within(at_m, corner_m):
                reach = f"{device.name} reaches from 0 to {point_text(corner_m)}"
                form = ", and a point is written as 60x40 mm" if isinstance(corner_m, complex) else ""
                raise PlacementError(f"a finger at {point_text(at_m)}: {reach}{form}")
        for (one_m, _), (next_m, _) in combinations(fingers, 2):
            if abs(next_m - one_m) < CLOSEST_M - _ROUNDING_M:
                raise PlacementError(
                    f"fingers at {point_text(one_m)} and {point_text(next_m)}: closer than {1e3 * CLOSEST_M:g} mm they "
                    "are one finger to the surface: give one of them"
                )
        return cls(tuple(at_m for at_m, _ in fingers), tuple(is_felt for _, is_felt in fingers))

    @classmethod
    def named(cls, device: "Device", felt: Sequence[str | complex], quiet: Sequence[str | complex] = ()) -> "Placement":
        """Fingers at points: texts with a unit ("35 mm", on a plate "35 x 60 mm"), numbers of metres, or zones' names.

        A zone means its middle. Raises PlacementError as `on`, and for a text that is neither a point nor a zone.

        >>> Placement.named(device, felt=["35 mm"], quiet=["IV", 0.16])
        """
        return cls.on(device, _positions_m(device, felt), _positions_m(device, quiet))

    def zone_states(self, device: "Device") -> tuple[ZoneState, ...]:
        """State of every zone: FELT where one of its fingers feels, else QUIET where one rests."""
        edges, states = ZoneFinder(device), [ZoneState.FREE] * len(device.zones)
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


def merged(fingers: Iterable[tuple[complex, bool]]) -> tuple[tuple[complex, ...], tuple[bool, ...], int]:
    """Fingers (point in metres, whether it feels) in rising order, those that are one to the surface joined.

    Returns points, roles, and how many fingers were joined to an earlier one in the order. Two fingers closer than
    CLOSEST_M are one, which feels if either does; it lies where the felt one lies, else where the earlier one does.
    """
    position_m, is_felt, joined = list[complex](), list[bool](), 0
    for at_m, feels in _sorted(fingers):
        near = next((k for k, each in enumerate(position_m) if abs(at_m - each) < CLOSEST_M - _ROUNDING_M), None)
        if near is None:
            position_m.append(at_m)
            is_felt.append(feels)
            continue
        joined += 1
        if feels and not is_felt[near]:
            position_m[near], is_felt[near] = at_m, True
    return tuple(position_m), tuple(is_felt), joined


def _sorted(fingers: Iterable[tuple[complex, bool]]) -> list[tuple[complex, bool]]:
    return sorted(fingers, key=lambda finger: (*order_of(finger[0]), finger[1]))


def _positions_m(device: "Device", named: Sequence[str | complex]) -> list[complex]:
    from engine.device.quantity import QuantityError, read_point

    if isinstance(named, str):
        raise PlacementError(f"fingers {named!r}: is one text; give a list, such as [{named!r}]")
    middle_m = {zone.name: zone.middle_m for zone in device.zones}
    found_m = list[complex]()
    for each in named:
        if not isinstance(each, str):
            found_m.append(complex(each) if isinstance(each, complex) else float(each))
        elif each in middle_m:
            found_m.append(middle_m[each])
        else:
            try:
                found_m.append(read_point(each))
            except QuantityError as error:
                raise PlacementError(f"{error}; or one of the zones {', '.join(middle_m)}") from None
    return found_m


@dataclass(frozen=True)
class Places:
    """Places over a surface from edge to edge: at least two `along` it, and on a plate at least two `across`.

    corner_m: the end of the bar, or the corner of the plate (base.points). Places are numbered as fingers are
    sorted: along the surface first, and across it where they are equally far along.
    """

    corner_m: complex
    along: int
    across: int = 1

    @classmethod
    def every(cls, corner_m: complex, pitch_m: float) -> "Places":
        """The fewest places that are at most `pitch_m` apart, at least two each way."""
        along, across = (
            1 + max(1, math.ceil(side_m / pitch_m - _ROUNDING)) if side_m else 1
            for side_m in (corner_m.real, corner_m.imag)
        )
        return cls(corner_m, along, across)

    @classmethod
    def at(cls, corner_m: complex, position_m: Sequence[complex]) -> "Places":
        """The places at these points (place,), as `position_m` gives them. Raises ValueError for any others."""
        across = max(1, sum(at_m.real == 0 for at_m in position_m))
        found = cls(corner_m, len(position_m) // across, across)
        even = found.along > 1 and (across > 1) == isinstance(corner_m, complex) and found.count == len(position_m)
        if even and all(abs(a - b) <= _ROUNDING for a, b in zip(position_m, found.position_m, strict=True)):
            return found
        raise ValueError("expected an even grid from one end of the surface to the other")

    @property
    def count(self) -> int:
        """Number of places."""
        return self.along * self.across

    @cached_property
    def pitch_m(self) -> float:
        """Greatest distance of neighbouring places of a row, or of a column."""
        return max(self.corner_m.real / (self.along - 1), self.corner_m.imag / max(1, self.across - 1))

    @cached_property
    def position_m(self) -> tuple[complex, ...]:
        """Points of the places."""
        along_m = [self.corner_m.real * (place / (self.along - 1)) for place in range(self.along)]
        if self.across == 1:
            return tuple(along_m)
        across_m = [self.corner_m.imag * (place / (self.across - 1)) for place in range(self.across)]
        return tuple(complex(x, y) for x in along_m for y in across_m)

    def nearest(self, position_m: complex) -> int:
        """The place nearest to a point; beyond an edge of the surface it is one at the edge."""
        along = _nearest(position_m.real, self.corner_m.real, self.along)
        return self.across * along + _nearest(position_m.imag, self.corner_m.imag, self.across)

    def key(self, placement: Placement) -> Key:
        """Key of a placement's nearest places; two fingers at one place are two equal or successive numbers."""
        fingers = zip(placement.position_m, placement.is_felt, strict=True)
        return tuple(sorted(2 * self.nearest(at_m) + is_felt for at_m, is_felt in fingers))

    def placement(self, key: Key) -> Placement:
        """The placement at the places' own positions that has this key."""
        return Placement(tuple(self.position_m[code // 2] for code in key), tuple(code % 2 == 1 for code in key))


def _nearest(at_m: float, side_m: float, count: int) -> int:
    return min(max(int(at_m / (side_m / (count - 1)) + 0.5), 0), count - 1) if count > 1 else 0
