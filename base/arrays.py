"""Types of the arrays that modules hand to one another."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]
Points = Array | Complex
"""Points of a surface (base.points): real on a bar, complex on a plate."""
