"""Linear program of a click: weights of tones with the greatest response at given instants, within every limit.

Theory of operation
-------------------
Unknowns are the weights x of some 44 tones, and the value v. Rows are dense:

- aims: a x >= v, one for each felt finger, a x being what it feels at one instant: the weakest finger counts;
- drive rows, |row x| <= 1: amplitude (and slew) at every sample of the waveform. They hold every x within bounds;
- watched rows, |row x| <= limit: quiet fingers of all sampled plants at all instants, some 20 000 of them.

Few watched rows matter, so they are *generated*: solve with the rows that were found so far, play the result through
all courses, and let in the highest peaks that pass the limit, or come near it in a course that does. Weights divided
by their worst violation keep to all limits, so each round gives a feasible value; the prices give an upper bound.
The rounds end when value and bound agree within the tolerance, or the bound falls below what is already had.

HiGHS solves each of them from where it ended, so rows found for one aim serve the next.
"""

from dataclasses import dataclass, replace
from typing import Protocol

import highspy
import numpy as np

from base.arrays import Array, Integers, Single
from base.errors import TactableError

TOLERANCE = 1e-4
"""A bound this close, relative, counts as met: 0.001 dB."""
_PEAKS = 2
"""Most rows of one course that are added in one round."""
_ROUNDS = 60
_OVER = 1e-5
"""Relative violation that is tolerated, since courses are played in single precision."""
_LET_IN = 0.95
"""Fraction of the limit below which peaks of a violated course are not added."""


class ProgramError(TactableError):
    """The solver failed on a program that always has a solution."""


class Watched(Protocol):
    """Courses that keep to the limit; `clicks.watched.WatchedCourses` is one."""

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of courses and of samples of each."""

    def play(self, weight: Array) -> Single:
        """Magnitudes (course, sample) for weights (tone,)."""

    def rows(self, numbers: Integers) -> Array:
        """Rows (row, tone) at instants given as course * samples + sample."""


@dataclass(frozen=True)
class Bound:
    """Upper bound on the value as a function of the limit: prices of drive rows, and of watched rows, summed."""

    drive: float
    watched: float

    def at(self, limit: float) -> float:
        """The bound where watched courses keep to `limit`."""
        return self.drive + limit * self.watched if self.watched else self.drive


UNBOUNDED = Bound(np.inf, 0.0)
"""The bound of an aim that was not tried yet."""


@dataclass(frozen=True)
class Optimum:
    """Weights (tone,) within every limit, their value, and the upper bound."""

    weight: Array
    value: float
    bound: Bound


class Program:
    """Maximise the smallest of aims @ x subject to |drive x| <= 1 and |watched x| <= limit.

    drive (row, tone) must have as many independent rows as there are tones. x = 0 is within all limits, and so is any
    feasible x scaled down.
    """

    def __init__(self, drive: Array, watched: Watched, aims: int) -> None:
        self._drive, self._watched, self._aims, self._limit = drive, watched, aims, 1.0
        self._entered = np.zeros(watched.shape, np.bool_)
        self._solver = highspy.Highs()  # type: ignore[no-untyped-call]  # highspy has stubs for part of itself
        # Rows are alike in size: scaling them doubles the iterations.
        for option, setting in (("output_flag", False), ("threads", 1), ("simplex_scale_strategy", 0)):
            self._solver.setOptionValue(option, setting)
        unknowns = drive.shape[1] + 1
        endless = np.full(unknowns, highspy.kHighsInf)
        self._solver.addVars(unknowns, -endless, endless)
        self._solver.changeObjectiveSense(highspy.ObjSense.kMaximize)
        self._solver.changeColCost(unknowns - 1, 1.0)
        self._add_rows(np.zeros((aims, drive.shape[1])), 0.0, highspy.kHighsInf, -1.0)
        self._add_rows(drive, -1.0, 1.0)

    @property
    def _first_watched(self) -> int:
        return self._aims + len(self._drive)

    def set_limit(self, limit: float) -> None:
        """Change the limit of the watched courses."""
        self._limit = limit
        for row in range(self._first_watched, self._solver.getNumRow()):
            self._solver.changeRowBounds(row, -limit, limit)

    def add(self, numbers: Integers) -> None:
        """Add watched rows, given as course * samples + sample; none may be among the rows already."""
        self._add_rows(self._watched.rows(numbers), -self._limit, self._limit)
        self._entered.flat[numbers] = True

    def maximise(self, aims: Array, floor: float = 0.0, tolerance: float = TOLERANCE) -> Optimum:
        """The best weights for aims (aim, tone), to `tolerance` relative; given up once the bound is below `floor`."""
        for row, aim in enumerate(aims):
            for tone, coefficient in enumerate(aim.tolist()):
                self._solver.changeCoeff(row, tone, coefficient)
        best = Optimum(np.zeros(aims.shape[1]), 0.0, UNBOUNDED)
        for _ in range(_ROUNDS):
            weight, bound = self._solve()
            least = bound.at(self._limit)
            course = self._watched.play(weight)
            violation = max(float(course.max(initial=0.0)) / self._limit, float(np.abs(self._drive @ weight).max()))
            value = float((aims @ weight).min()) / max(1.0, violation)
            is_better = value >= best.value
            best = Optimum(weight / max(1.0, violation), value, bound) if is_better else replace(best, bound=bound)
            if best.value >= least * (1 - tolerance) or least <= floor or not self._add_violated(course):
                break
        return best

    def _add_rows(self, rows: Array, low: float, high: float, of_value: float = 0.0) -> None:
        """Add rows (row, tone) with the same limits and coefficient of the value."""
        count, unknowns = len(rows), rows.shape[1] + 1
        dense = np.column_stack([rows, np.full(count, of_value)]).ravel()
        starts, columns = np.arange(count, dtype=np.int32) * unknowns, np.arange(unknowns, dtype=np.int32)
        below, above = np.full(count, low), np.full(count, high)
        self._solver.addRows(count, below, above, dense.size, starts, np.tile(columns, count), dense)

    def _solve(self) -> tuple[Array, Bound]:
        """The best weights for the rows so far, and the bound that their prices prove."""
        self._solver.run()
        if self._solver.getModelStatus() != highspy.HighsModelStatus.kOptimal:
            status = self._solver.modelStatusToString(self._solver.getModelStatus())
            raise ProgramError(f"click: HiGHS ends with {status!r}: fewer tones (crowding) are less alike")
        solution = self._solver.getSolution()
        price = np.abs(solution.row_dual)
        drive, watched = price[self._aims : self._first_watched], price[self._first_watched :]
        return np.array(solution.col_value)[:-1], Bound(float(drive.sum()), float(watched.sum()))

    def _add_violated(self, course: Single) -> bool:
        """Add the highest peaks of every course (course, sample) that exceeds the limit; False if none does."""
        over = course.max(axis=1, initial=0.0) > self._limit * (1 + _OVER)
        beside = np.pad(course, ((0, 0), (1, 1)))
        is_peak = (course >= beside[:, :-2]) & (course >= beside[:, 2:]) & (course > self._limit * _LET_IN)
        height = np.where(is_peak & ~self._entered & over[:, None], course, 0.0)
        highest = np.argsort(-height, axis=1)[:, :_PEAKS]
        which, rank = np.nonzero(np.take_along_axis(height, highest, axis=1))
        if len(which):
            self.add(which * course.shape[1] + highest[which, rank])
        return len(which) > 0
