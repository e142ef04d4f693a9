"""A placement: the fingers on the bar, each at its position and with its role; what drives and clicks are made for."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite
from typing import TYPE_CHECKING

from engine.touch.finger_tracker import ZoneState
from firmware_link.protocol.errors import TactableError

if TYPE_CHECKING:
    from engine.device import Device

MOST_FINGERS = 10
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
    def in_zones(cls, device: "Device", states: Sequence[ZoneState]) -> "Placement":
        """A finger in the middle of every zone that is not free."""
        touched = [
            (zone, state) for zone, state in zip(device.zones, states, strict=True) if state is not ZoneState.FREE
        ]
        return cls(
            tuple((zone.start_m + zone.stop_m) / 2 for zone, _ in touched),
            tuple(state is ZoneState.FELT for _, state in touched),
        )

    @property
    def felt(self) -> list[int]:
        """Indices of the fingers that feel."""
        return [finger for finger, is_felt in enumerate(self.is_felt) if is_felt]

    @property
    def quiet(self) -> list[int]:
        """Indices of the fingers that are to feel nothing."""
        return [finger for finger, is_felt in enumerate(self.is_felt) if not is_felt]
