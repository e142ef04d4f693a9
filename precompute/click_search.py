"""What every felt finger feels of each tone to the best click: instants and signs are tried, each a linear program."""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from precompute.click_basis import LOOK_RATE_HZ
from precompute.click_program import TOLERANCE, Optimum, Program

Array = NDArray[np.float64]

STEP_S = 2e-3
"""Instants tried lie this far apart; from the best one the search goes on to the peaks around it."""
AFTER_S = 2e-3
"""Instants are tried from the middle of the click until so long after its end."""
NEGLIGIBLE = 1e-2
"""Instants that promise no more than this beyond the best, relative, are left: 0.09 dB."""
_MOST = 24
_ASCENTS = 6


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
    """The best weights of the tones; `bound`: no weights do better at any aim that was tried."""

    aim: Aim
    optimum: Optimum
    bound: float

    def scaled(self, factor: float) -> "Strongest":
        """The same for limits that are all so many times as wide."""
        return Strongest(self.aim, self.optimum.scaled(factor), self.bound * factor)


def search_click(program: Program, course: Array, length_s: float) -> Strongest:
    """Maximise the weakest felt finger; course (finger, time, tone) averaged over the scenarios.

    Every aim is bounded by the rows that are already in; those that promise most are solved, until none promises more
    than the best. All fingers are tried at common instants; then each goes to its own peak, as long as that helps.
    """
    aims = _aims(len(course), length_s)
    promised = np.array([program.bound(aim.rows(course)) for aim in aims])
    best, chosen = Optimum(np.zeros(course.shape[2]), 0.0, np.inf), aims[0]
    for tried, index in enumerate(np.argsort(-promised).tolist()):
        floor = best.value * (1 + NEGLIGIBLE)
        if promised[index] <= floor or tried >= _MOST:
            break
        found = program.maximise(aims[index].rows(course), floor)
        promised[index] = min(promised[index], found.bound)
        if found.value > best.value:
            best, chosen = found, aims[index]
    chosen, best = _ascend(program, course, chosen, best)
    return Strongest(chosen, best, max(float(promised.max()), best.bound))


def _aims(fingers: int, length_s: float) -> list[Aim]:
    """Common instants, and every choice of signs; the first is positive, for limits are even."""
    instants = np.arange(length_s / 2, length_s + AFTER_S, STEP_S) * LOOK_RATE_HZ
    signs = [np.array([1.0, *rest]) for rest in itertools.product((1.0, -1.0), repeat=fingers - 1)]
    return [
        Aim(np.full(fingers, round(instant), dtype=np.int64), sign) for instant in instants.tolist() for sign in signs
    ]


def _ascend(program: Program, course: Array, aim: Aim, best: Optimum) -> tuple[Aim, Optimum]:
    """Each finger to where its course is greatest: the value can only rise."""
    for _ in range(_ASCENTS):
        felt = course @ best.weight
        instant = np.abs(felt).argmax(axis=1)
        sign = np.sign(felt[np.arange(len(felt)), instant])
        moved = Aim(instant, sign)
        found = program.maximise(moved.rows(course))
        if found.value <= best.value * (1 + 10 * TOLERANCE):
            break
        aim, best = moved, found
    return aim, best
