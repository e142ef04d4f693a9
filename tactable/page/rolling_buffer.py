"""The newest samples of many columns, in bounded memory."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class RollingBuffer:
    """Keeps the last `kept` samples (time, column); they are zeros at first."""

    def __init__(self, kept: int, columns: int) -> None:
        self.kept = kept
        # Twice as long as kept: samples are moved to the front only when the end is reached, once in `kept` samples.
        self._values = np.zeros((2 * kept, columns))
        self._end = kept

    def push(self, samples: Array) -> None:
        """Append samples (time, column); the oldest are dropped."""
        samples = samples[-self.kept :]
        if self._end + len(samples) > len(self._values):
            rest = self.kept - len(samples)
            self._values[:rest] = self._values[self._end - rest : self._end].copy()
            self._end = rest
        self._values[self._end : self._end + len(samples)] = samples
        self._end += len(samples)

    def last(self, count: int) -> Array:
        """A view of the newest `count` samples, at most `kept`, valid until the next push."""
        return self._values[self._end - count : self._end]
