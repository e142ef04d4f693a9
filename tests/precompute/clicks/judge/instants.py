"""Search for the instants at which felt fingers are to peak: branch by instant and sign, prune by dual bounds.

A click counts by the greatest magnitude of each felt finger's time course, whenever it comes. That is not concave, but
for a given instant and sign of every felt finger (an aim) the strongest click is a linear program. With F felt
fingers and N instants there are (2 N)^F / 2 aims, too many to try. So:

1. All fingers share one instant, on a grid of STEP_S, with every combination of signs; the sign of the first finger is
   positive, because all limits are symmetric.
2. Aims are solved in the order of their upper bounds, roughly, and each only until its own bound falls below the best
   value found. The search stops when no bound promises the given gain more.
3. From the best few, ascent: every finger is given the instant and the sign of its own peak, and the program is solved
   again. The old weights stay feasible with at least their value, so the value cannot fall; it ends when it stays.

The designer asks for several limits of the quiet fingers in turn. A Bound is a function of the limit, so under another
limit only aims that still promise more are solved again.
"""

import itertools
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from base.arrays import Array, Integers
from precompute.clicks.click_basis import EVALUATION_RATE_HZ
from tests.precompute.clicks.judge.program import TOLERANCE, UNBOUNDED, Optimum

STEP_S = 4e-3
"""Spacing of the instants that are tried; ascent reaches the peaks between them.

A quarter of it gains less than 0.1 dB on average and takes more than twice as long.
"""
AFTER_S = 2e-3
"""Instants are tried from the middle of the click until this long after its end."""
_COARSE = 2e-3
"""Relative tolerance of a program whose value is only compared with others."""
_LIKELY = 0.75
"""Fraction of the click at which the best instants lie most often; they are tried first, to prune the others."""
_ASCENTS = 6
_ASCENT_STARTS = 4
"""Number of the best common aims from which the search ascends."""


class LinearProgram(Protocol):
    """Solves aims one after another; `clicks.program.Program` is one."""

    def set_limit(self, limit: float) -> None:
        """Change the limit of the watched courses."""

    def maximise(self, aims: Array, floor: float = ..., tolerance: float = ...) -> Optimum:
        """The best weights for aims (aim, tone), to `tolerance` relative; given up once the bound is below `floor`."""


@dataclass(frozen=True)
class Aim:
    """Instant (finger,), an index into the time course of each felt finger, and sign (finger,) of its peak."""

    instant: Integers
    sign: Array

    def is_same(self, other: "Aim") -> bool:
        """Whether both ask for the same instants and signs."""
        return np.array_equal(self.instant, other.instant) and np.array_equal(self.sign, other.sign)

    def rows(self, course: Array) -> Array:
        """Rows (finger, tone) to be maximised, from course (finger, time, tone)."""
        rows: Array = course[np.arange(len(course)), self.instant] * self.sign[:, None]
        return rows


@dataclass(frozen=True)
class Found:
    """An aim with its optimal weights."""

    aim: Aim
    optimum: Optimum


class Search:
    """Maximises the peak of the weakest felt finger; course (finger, time, tone) is the mean over the scenarios.

    gain: relative gain below which an aim is not pursued.
    """

    def __init__(self, program: LinearProgram, course: Array, length_s: float, gain: float) -> None:
        self._program, self._course, self._gain = program, course, gain
        self._aims = _aims(len(course), length_s)
        self._bounds = [UNBOUNDED] * len(self._aims)
        self._first = 0
        self._last: Found | None = None

    def strongest(self, limit: float) -> Found:
        """The best aim found under `limit`, the limit of the watched courses."""
        self._program.set_limit(limit)
        tried = [self._maximise(self._first, 0.0)]
        best, untried = tried[0], set(range(len(self._aims))) - {self._first}
        while untried:
            index = max(untried, key=lambda i: (self._bounds[i].at(limit), -i))
            floor = best.value * (1 + self._gain)
            if self._bounds[index].at(limit) <= floor:
                break
            untried.discard(index)
            tried.append(self._maximise(index, floor))
            if tried[-1].value > best.value:
                best, self._first = tried[-1], index
        if self._last is not None:
            tried.append(self.improve(self._last.aim, limit))
        # One finger ascends to its best instant at once; several have peaks that no common instant reveals.
        ascents = 1 if len(self._course) == 1 else _ASCENT_STARTS
        likely = sorted(tried, key=lambda found: -self._peak_aim(found.weight)[1])[:ascents]
        self._last = max((self._ascend(found) for found in likely), key=lambda found: found.optimum.value)
        return self._last

    def improve(self, aim: Aim, limit: float) -> Optimum:
        """The optimum of one aim under `limit`."""
        self._program.set_limit(limit)
        return self._program.maximise(aim.rows(self._course))

    def bound(self, limit: float) -> float:
        """Upper bound under `limit` on the value at any common aim."""
        return max(bound.at(limit) for bound in self._bounds)

    def _maximise(self, index: int, floor: float) -> Optimum:
        found = self._program.maximise(self._aims[index].rows(self._course), floor, _COARSE)
        self._bounds[index] = found.bound
        return found

    def _ascend(self, begun: Optimum) -> Found:
        """Move every finger to its own peak and solve again while the value rises."""
        best: Found | None = None
        for _ in range(_ASCENTS):
            aim, _ = self._peak_aim(begun.weight)
            if best is not None and aim.is_same(best.aim):
                return best
            found = self._program.maximise(aim.rows(self._course))
            if best is not None and found.value <= best.optimum.value * (1 + 10 * TOLERANCE):
                return best
            best, begun = Found(aim, found), found
        assert best is not None
        return best

    def _peak_aim(self, weight: Array) -> tuple[Aim, float]:
        """Instants and signs of every felt finger's peak, and the smallest of the peaks."""
        felt = self._course @ weight
        instant = np.abs(felt).argmax(axis=1)
        peak = felt[np.arange(len(felt)), instant]
        return Aim(instant, np.sign(peak)), float(np.abs(peak).min())


def _aims(fingers: int, length_s: float) -> list[Aim]:
    """Aims with a common instant, the likely instants first, and every combination of signs."""
    instants_s = np.arange(length_s / 2, length_s + AFTER_S, STEP_S)
    instants_s = instants_s[np.argsort(abs(instants_s - _LIKELY * length_s), kind="stable")]
    signs = [np.array([1.0, *rest]) for rest in itertools.product((1.0, -1.0), repeat=fingers - 1)]
    return [
        Aim(np.full(fingers, round(instant_s * EVALUATION_RATE_HZ), dtype=np.int64), sign)
        for instant_s in instants_s.tolist()
        for sign in signs
    ]
