"""Places: an even grid along the bar, whose points the tabulated clicks are made for.

A finger belongs to the nearest place. The fingers of a placement, each as the number 2 * place + 1 where it feels and
2 * place where it is quiet, in rising order, are the key of a click.
"""

import math
from dataclasses import dataclass
from functools import cached_property

from engine.touch.placement import Placement

Key = tuple[int, ...]
"""2 * place + is_felt of each finger, rising."""
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Places:
    """`count` places from one end of a bar of `length_m` to the other, at least two."""

    length_m: float
    count: int

    @classmethod
    def every(cls, length_m: float, pitch_m: float) -> "Places":
        """The fewest places that are at most `pitch_m` apart, at least two."""
        return cls(length_m, 1 + max(1, math.ceil(length_m / pitch_m - _ROUNDING)))

    @property
    def pitch_m(self) -> float:
        """Distance of neighbouring places."""
        return self.length_m / (self.count - 1)

    @cached_property
    def position_m(self) -> tuple[float, ...]:
        """Positions of the places from the start of the bar."""
        return tuple(self.length_m * (place / (self.count - 1)) for place in range(self.count))

    def nearest(self, position_m: float) -> int:
        """The place nearest to a position; beyond an end of the bar it is the last one."""
        return min(max(int(position_m / self.pitch_m + 0.5), 0), self.count - 1)

    def key(self, placement: Placement) -> Key:
        """Key of a placement's nearest places; two fingers at one place are two equal or successive numbers."""
        fingers = zip(placement.position_m, placement.is_felt, strict=True)
        return tuple(sorted(2 * self.nearest(at_m) + is_felt for at_m, is_felt in fingers))

    def placement(self, key: Key) -> Placement:
        """The placement at the places' own positions that has this key."""
        return Placement(tuple(self.position_m[code // 2] for code in key), tuple(code % 2 == 1 for code in key))
