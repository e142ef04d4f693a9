"""Places: an even grid over the surface, whose points the tabulated clicks are made for.

A finger belongs to the nearest place. The fingers of a placement, each as the number 2 * place + 1 where it feels and
2 * place where it is quiet, in rising order, are the key of a click.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from engine.touch.placement import Placement

Key = tuple[int, ...]  # 2 * place + is_felt of each finger, rising
_ROUNDING = 1e-9


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
