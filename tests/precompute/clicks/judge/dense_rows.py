"""Programs whose watched courses are given as all their rows."""

import numpy as np

from base.arrays import Array, Integers, Single
from tests.precompute.clicks.judge.program import Program


class Dense:
    """Watched courses given as all their rows (course, time, tone)."""

    def __init__(self, rows: Array) -> None:
        self._rows = rows

    @property
    def shape(self) -> tuple[int, int]:
        return self._rows.shape[0], self._rows.shape[1]

    def play(self, weight: Array) -> Single:
        return abs(self._rows @ weight).astype(np.float32)

    def rows(self, numbers: Integers) -> Array:
        chosen: Array = self._rows.reshape(-1, self._rows.shape[2])[numbers]
        return chosen


def program_of(kept: Array, watched: Array, aims: int) -> Program:
    return Program(kept, Dense(watched), aims)
