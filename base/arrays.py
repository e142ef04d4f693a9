"""Types of the arrays that modules hand to one another."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]
Single = NDArray[np.float32]
Complex32 = NDArray[np.complex64]
Points = Array | Complex  # points of a surface (base.points): real on a bar, complex on a plate
FIELD_POINTS = 61  # most points of a field along the longer side: 5 mm apart on 300 mm
_ROUNDING = 1e-9


def even_points(start_m: complex, stop_m: complex, along: int, across: int = 1) -> Any:
    """Evenly spaced points from corner to corner, both included, as an array (along * across,), row by row."""
    x = np.linspace(start_m.real, stop_m.real, along)
    if not isinstance(start_m, complex):
        return x
    return (x + 1j * np.linspace(start_m.imag, stop_m.imag, across)[:, None]).ravel()


@dataclass(frozen=True)
class Field:
    """Evenly spaced points over a surface up to `corner_m`: `across` rows of `along` points."""

    corner_m: complex
    along: int
    across: int

    @classmethod
    def of(cls, corner_m: complex, most: int, most_along: int = FIELD_POINTS) -> "Field":
        """The finest of at most `most` points, and of at most `most_along` along the longer side."""
        sides_m = corner_m.real, corner_m.imag
        fields = (
            cls(corner_m, *(1 + math.ceil(steps * side_m / max(sides_m) - _ROUNDING) for side_m in sides_m))
            for steps in range(most_along - 1, 0, -1)
        )
        return next(field for field in fields if field.count <= most)

    @property
    def count(self) -> int:
        """Number of points."""
        return self.along * self.across

    @property
    def position_m(self) -> Points:
        """Shape (point,): the points, row by row."""
        found: Points = even_points(0 * self.corner_m, self.corner_m, self.along, self.across)
        return found
