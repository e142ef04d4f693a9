"""What every felt finger feels of each tone to the best click: instants and signs are tried, each a linear program."""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from precompute.clicks.basis import LOOK_RATE_HZ
from precompute.clicks.program import TOLERANCE, UNBOUNDED, Optimum, Program

Array = NDArray[np.float64]

STEP_S = 4e-3
"""Instants tried lie this far apart; from the best ones the search goes on to the peaks around them.

Four times as many bring less than 0.1 dB on average, and take more than twice as long.
"""
AFTER_S = 2e-3
"""Instants are tried from the middle of the click until so long after its end."""
NEGLIGIBLE = 1e-2
"""Instants that promise no more than this beyond the best, relative, are left: 0.09 dB."""
_COARSE = 2e-3
"""So closely an aim is solved to be compared with others."""
_LIKELY = 0.75
"""Where in the click the best instants lie most often; what is tried first prunes the others."""
_ASCENTS = 6
_CLIMBED = 4
"""Of what was found at common instants, so many are climbed from."""


@dataclass(frozen=True)
class Aim:
    """The instant (finger,), an index into the course of each felt finger, and the sign (finger,) it is to have."""

    instant: NDArray[np.int64]
    sign: Array

    def rows(self, course: Array) -> Array:
        """Shape (finger, tone): what is to be great, from course (finger, time, tone)."""
        rows: Array = course[np.arange(len(course)), self.instant] * self.sign[:, None]
        return rows


@dataclass(frozen=True)
class Strongest:
    """The best weights of the tones, and what they are best for."""

    aim: Aim
    optimum: Optimum


class Search:
    """Maximises the weakest felt finger; course (finger, time, tone) averaged over the scenarios.

    An aim is solved until its bound promises no more than the best. Bounds hold whatever the limit of the watched
    courses, so that under another limit only the aims that still promise more are solved once more. All fingers are
    tried at common instants; from the best of these each goes to its own peak, as long as that helps.
    """

    def __init__(self, program: Program, course: Array, length_s: float) -> None:
        self._program, self._course = program, course
        self._aims = _aims(len(course), length_s)
        self._bounds = [UNBOUNDED] * len(self._aims)
        self._first = 0
        self._before: Strongest | None = None

    def strongest(self, limit: float) -> Strongest:
        """The best that was found of all aims where watched courses keep to `limit`."""
        self._program.set_limit(limit)
        tried = [self._maximise(self._first, 0.0)]
        best, untried = tried[0], set(range(len(self._aims))) - {self._first}
        while untried:
            index = max(untried, key=lambda untried_one: (self._bounds[untried_one].at(limit), -untried_one))
            floor = best.value * (1 + NEGLIGIBLE)
            if self._bounds[index].at(limit) <= floor:
                break
            untried.discard(index)
            tried.append(self._maximise(index, floor))
            if tried[-1].value > best.value:
                best, self._first = tried[-1], index
        if self._before is not None:
            tried.append(self.improve(self._before.aim, limit))
        # With one finger the best instant is where the climb ends; several have peaks that no common instant tells.
        climbed = 1 if len(self._course) == 1 else _CLIMBED
        likely = sorted(tried, key=lambda found: -self._peak_aim(found.weight)[1])[:climbed]
        self._before = max((self._climb(found.weight) for found in likely), key=lambda found: found.optimum.value)
        return self._before

    def improve(self, aim: Aim, limit: float) -> Optimum:
        """The best for one aim where watched courses keep to `limit`."""
        self._program.set_limit(limit)
        return self._program.maximise(aim.rows(self._course))

    def bound(self, limit: float) -> float:
        """What no weights exceed at any of the aims where watched courses keep to `limit`."""
        return max(bound.at(limit) for bound in self._bounds)

    def _maximise(self, index: int, floor: float) -> Optimum:
        found = self._program.maximise(self._aims[index].rows(self._course), floor, _COARSE)
        self._bounds[index] = found.bound
        return found

    def _climb(self, weight: Array) -> Strongest:
        """Each finger to where its course is greatest, again and again: the value can only rise."""
        best: Strongest | None = None
        for _ in range(_ASCENTS):
            aim, _ = self._peak_aim(weight)
            found = self._program.maximise(aim.rows(self._course))
            if best is not None and found.value <= best.optimum.value * (1 + 10 * TOLERANCE):
                return best
            best, weight = Strongest(aim, found), found.weight
        assert best is not None
        return best

    def _peak_aim(self, weight: Array) -> tuple[Aim, float]:
        """Where every felt finger has its peak, and the smallest of the peaks."""
        felt = self._course @ weight
        instant = np.abs(felt).argmax(axis=1)
        peak = felt[np.arange(len(felt)), instant]
        return Aim(instant, np.sign(peak)), float(np.abs(peak).min())


def _aims(fingers: int, length_s: float) -> list[Aim]:
    """Common instants, the likely ones first, and every choice of signs; the first is positive, for limits are even."""
    instants_s = np.arange(length_s / 2, length_s + AFTER_S, STEP_S)
    instants_s = instants_s[np.argsort(abs(instants_s - _LIKELY * length_s), kind="stable")]
    signs = [np.array([1.0, *rest]) for rest in itertools.product((1.0, -1.0), repeat=fingers - 1)]
    return [
        Aim(np.full(fingers, round(instant_s * LOOK_RATE_HZ), dtype=np.int64), sign)
        for instant_s in instants_s.tolist()
        for sign in signs
    ]
