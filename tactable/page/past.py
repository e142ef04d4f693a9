"""What was lately: the newest samples of many columns, in memory that does not grow."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Past:
    """The last `kept` samples (time, column); zeros before the first."""

    def __init__(self, kept: int, columns: int) -> None:
        self.kept = kept
        # Twice as long: what is kept moves to the front only when the end is reached.
        self._values = np.zeros((2 * kept, columns))
        self._end = kept

    def push(self, samples: Array) -> None:
        """Newer samples (time, column), of which more than are kept are forgotten."""
        samples = samples[-self.kept :]
        if self._end + len(samples) > len(self._values):
            rest = self.kept - len(samples)
            self._values[:rest] = self._values[self._end - rest : self._end].copy()
            self._end = rest
        self._values[self._end : self._end + len(samples)] = samples
        self._end += len(samples)

    def last(self, count: int) -> Array:
        """A view of the newest `count`, at most `kept`; it is good until the next push."""
        return self._values[self._end - count : self._end]

    def forget(self, column: int) -> None:
        """Nothing was in a column."""
        self._values[:, column] = 0.0
