"""Linear program: the weights that make given sums as great as can be while every watched course keeps to a limit."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import highspy
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TOLERANCE = 1e-4
"""A bound this close, relative, is as good as met: 0.001 dB."""
_PEAKS = 4
"""Rows added at most of one course in one round."""
_ROUNDS = 60
_OVER = 1e-9
_NEAR = 0.6
"""Rows that the last weights bring no closer to the limit than so are taken out before another aim is solved."""
_WORTH_IT = 100
"""Of them there must be so many: taking rows out has its price too."""


class ProgramError(RuntimeError):
    """The solver failed on a program that always has a solution."""


@dataclass(frozen=True)
class Bound:
    """What no weights exceed, whatever the limit: the sums of the dual prices of the kept and of the watched rows."""

    kept: float
    watched: float

    def at(self, limit: float) -> float:
        """What no weights exceed where watched courses keep to `limit`."""
        return self.kept + limit * self.watched if self.watched else self.kept


ENDLESS = Bound(np.inf, 0.0)
"""Of what was not yet tried."""


@dataclass(frozen=True)
class Optimum:
    """Weights (tone,) that keep to every limit exactly, their value, and what no weights exceed."""

    weight: Array
    value: float
    bound: Bound


class Program:
    """Maximise the smallest of aims @ x, |kept x| <= 1 and |watched x| <= limit; watched rows enter as they are needed.

    kept (row, tone) must hold every x within bounds; watched (course, time, tone). Rows found for one aim serve the
    next, and the solver goes on from where it was. The limits are even: x = 0 keeps to them, so does x scaled down.
    """

    def __init__(self, kept: Array, watched: Array, aims: int) -> None:
        self._kept, self._watched, self._aims = kept, watched, aims
        self._rows = watched.reshape(-1, watched.shape[-1])
        self._entered = np.zeros(watched.shape[:2], dtype=np.bool_)
        self._order = np.zeros(0, dtype=np.int64)
        """Of the watched rows that are in: where they stand among all of them."""
        self._limit = 1.0
        self._tones = kept.shape[1]
        self._columns = np.arange(self._tones + 1, dtype=np.int32)  # the last is what all aims exceed
        endless = np.full(self._tones + 1, highspy.kHighsInf)
        self._solver = highspy.Highs()  # type: ignore[no-untyped-call]  # highspy has stubs for part of itself
        for option, value in (("output_flag", False), ("presolve", "off"), ("threads", 1)):
            self._solver.setOptionValue(option, value)
        self._solver.addVars(self._tones + 1, -endless, endless)
        self._solver.changeObjectiveSense(highspy.ObjSense.kMaximize)
        self._solver.changeColCost(self._tones, float(aims > 1))
        if aims > 1:
            self._add(np.column_stack([np.zeros((aims, self._tones)), -np.ones(aims)]), 0.0, highspy.kHighsInf)
        else:
            self._solver.changeColBounds(self._tones, 0.0, 0.0)
        self._first_kept = aims if aims > 1 else 0
        self._first_watched = self._first_kept + len(kept)
        self._add_limits(kept, 1.0)

    @property
    def rows(self) -> int:
        """How many of the watched rows are in."""
        return len(self._order)

    def set_limit(self, limit: float) -> None:
        """Change what the watched courses keep to."""
        self._limit = limit
        rows = np.arange(self._first_watched, self._first_watched + len(self._order), dtype=np.int32)
        limits = np.full(len(rows), limit)
        self._solver.changeRowsBounds(len(rows), rows, -limits, limits)  # type: ignore[attr-defined]  # as above

    def maximise(self, aims: Array, floor: float = 0.0, tolerance: float = TOLERANCE) -> Optimum:
        """Rows are added where they are violated until the bound is met within the tolerance, or lies below `floor`.

        Weights divided by their greatest violation keep to all limits.
        """
        self._aim_at(aims)
        best = Optimum(np.zeros(self._tones), 0.0, ENDLESS)
        for _ in range(_ROUNDS):
            weight, bound = self._solve()
            course = np.abs(self._rows @ weight).reshape(self._entered.shape)
            worst = max(1.0, float(course.max(initial=0.0)) / self._limit, float(np.abs(self._kept @ weight).max()))
            value = float((aims @ weight).min()) / worst
            best = Optimum(weight / worst, value, bound) if value >= best.value else replace(best, bound=bound)
            least = bound.at(self._limit)
            if best.value >= least * (1 - tolerance) or least <= floor or not self._add_violated(course):
                break
        return best

    def _aim_at(self, aims: Array) -> None:
        self._take_out_idle()
        if self._aims == 1:
            self._solver.changeColsCost(self._tones, self._columns[:-1], aims[0])
            return
        for (aim, tone), value in np.ndenumerate(aims):
            self._solver.changeCoeff(aim, tone, value)

    def _solve(self) -> tuple[Array, Bound]:
        """The best weights for the rows that are in, and the bound that their prices prove."""
        if not self._is_solved():
            self._solver.clearSolver()  # what it went on from was too ill-conditioned: from the start once more
            if not self._is_solved():
                status = self._solver.modelStatusToString(self._solver.getModelStatus())
                raise ProgramError(f"click: HiGHS ends with {status!r}: fewer tones (crowding) are less alike")
        solution = self._solver.getSolution()
        price = np.abs(solution.row_dual)
        kept = price[self._first_kept : self._first_watched].sum()
        return np.array(solution.col_value)[:-1], Bound(float(kept), float(price[self._first_watched :].sum()))

    def _is_solved(self) -> bool:
        self._solver.run()
        return bool(self._solver.getModelStatus() == highspy.HighsModelStatus.kOptimal)

    def _add_violated(self, course: Array) -> bool:
        """Let in the highest peaks of every course that lie beyond the limit; whether there are any."""
        found = list(self._violated(course))
        if found:
            new = np.concatenate(found)
            self._order = np.concatenate([self._order, new])
            self._entered.flat[new] = True
            self._add_limits(self._rows[new], self._limit)
        return bool(found)

    def _violated(self, course: Array) -> Iterator[NDArray[np.int64]]:
        """Of every course that has any: where the rows of its highest peaks stand."""
        peak = (course > self._limit * (1 + _OVER)) & ~self._entered
        peak[:, 1:] &= course[:, 1:] >= course[:, :-1]
        peak[:, :-1] &= course[:, :-1] >= course[:, 1:]
        for index in np.flatnonzero(peak.any(axis=1)).tolist():
            times = np.flatnonzero(peak[index])
            yield index * course.shape[1] + times[np.argsort(course[index, times])[-_PEAKS:]]

    def _take_out_idle(self) -> None:
        """Programs are solved the faster the fewer rows they have, and other aims press on other rows."""
        if not len(self._order):
            return
        reached = np.abs(self._solver.getSolution().row_value)[self._first_watched :]
        idle = np.ones(len(self._order), dtype=np.bool_)
        idle[: len(reached)] = reached < _NEAR * self._limit
        if np.count_nonzero(idle) < _WORTH_IT:
            return
        self._entered.flat[self._order[idle]] = False
        self._order = self._order[~idle]
        rows = (self._first_watched + np.flatnonzero(idle)).astype(np.int32)
        self._solver.deleteRows(len(rows), rows)

    def _add_limits(self, rows: Array, limit: float) -> None:
        self._add(np.column_stack([rows, np.zeros(len(rows))]), -limit, limit)

    def _add(self, rows: Array, low: float, high: float) -> None:
        count, size = rows.shape
        starts = np.arange(0, rows.size, size, dtype=np.int32)
        columns = np.tile(self._columns, count)
        self._solver.addRows(
            count,
            np.full(count, low),
            np.full(count, high),
            rows.size,
            starts,
            columns,
            np.ascontiguousarray(rows.ravel()),
        )
