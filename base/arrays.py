"""Types of the arrays that modules hand to one another."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]
Points = Array | Complex
"""Points of a surface (base.points): real on a bar, complex on a plate."""


def even_points(start_m: complex, stop_m: complex, along: int, across: int = 1) -> Any:
    """Even points from corner to corner, edges included, as an array (along * across,): row by row on a plate."""
    x = np.linspace(start_m.real, stop_m.real, along)
    if not isinstance(start_m, complex):
        return x
    return (x + 1j * np.linspace(start_m.imag, stop_m.imag, across)[:, None]).ravel()
