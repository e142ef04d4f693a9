"""Linear program: the weights that make given sums as great as can be while every watched course stays within 1."""

from collections.abc import Iterator
from dataclasses import dataclass

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


class ProgramError(RuntimeError):
    """The solver failed on a program that always has a solution."""


@dataclass(frozen=True)
class Optimum:
    """Weights (tone,) that keep to every limit exactly, their value, and what no weights exceed."""

    weight: Array
    value: float
    bound: float

    def scaled(self, factor: float) -> "Optimum":
        """The same for limits that are all so many times as wide."""
        return Optimum(self.weight * factor, self.value * factor, self.bound * factor)


class Program:
    """Maximise the smallest of aims @ x, |kept x| <= room and |watched x| <= 1; watched rows enter as they are needed.

    kept (row, tone) must hold every x within bounds; watched (course, time, tone). Rows found for one aim serve the
    next, and the solver goes on from where it was. The limits are even: x = 0 keeps to them, so does x scaled down.
    """

    def __init__(self, kept: Array, watched: Array, aims: int) -> None:
        self._kept, self._watched, self._aims = kept, watched, aims
        self._rows = watched.reshape(-1, watched.shape[-1])
        self._entered = np.zeros(watched.shape[:2], dtype=np.bool_)
        self._room = 1.0
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
        self._add_rows(kept)

    def set_room(self, room: float) -> None:
        """Change what the kept rows may reach."""
        self._room = room
        rows = np.arange(self._first_kept, self._first_kept + len(self._kept), dtype=np.int32)
        limit = np.full(len(rows), room)
        self._solver.changeRowsBounds(len(rows), rows, -limit, limit)  # type: ignore[attr-defined]  # as above

    def bound(self, aims: Array) -> float:
        """What the smallest of aims (aim, tone) @ x does not exceed, from the rows that are in."""
        return float((aims @ self._solve(aims)).min())

    def maximise(self, aims: Array, floor: float = 0.0) -> Optimum:
        """Rows are added where they are violated until the bound is met within TOLERANCE, or lies below `floor`.

        Weights divided by their greatest violation keep to all limits.
        """
        best = Optimum(np.zeros(self._tones), 0.0, np.inf)
        for _ in range(_ROUNDS):
            weight = self._solve(aims)
            reached = float((aims @ weight).min())
            course = np.abs(self._rows @ weight).reshape(self._entered.shape)
            worst = max(1.0, float(course.max(initial=0.0)), float(np.abs(self._kept @ weight).max()) / self._room)
            bound = min(best.bound, reached)
            scaled = Optimum(weight / worst, reached / worst, bound)
            best = scaled if scaled.value >= best.value else Optimum(best.weight, best.value, bound)
            violated = [self._watched[index, times] for index, times in self._violated(course)]
            if best.value >= bound * (1 - TOLERANCE) or bound <= floor or not violated:
                break
            self._add_rows(np.concatenate(violated))
        return best

    def _violated(self, course: Array) -> Iterator[tuple[int, NDArray[np.int64]]]:
        """The highest peaks of every course that lie beyond 1: its index, their times."""
        before = np.pad(course[:, :-1], ((0, 0), (1, 0)))
        after = np.pad(course[:, 1:], ((0, 0), (0, 1)))
        peak = (course >= before) & (course >= after) & (course > 1 + _OVER) & ~self._entered
        for index in np.flatnonzero(peak.any(axis=1)).tolist():
            times = np.flatnonzero(peak[index])
            chosen = times[np.argsort(course[index, times])[-_PEAKS:]]
            self._entered[index, chosen] = True
            yield index, chosen

    def _solve(self, aims: Array) -> Array:
        if self._aims == 1:
            self._solver.changeColsCost(self._tones, self._columns[:-1], aims[0])
        else:
            for (aim, tone), value in np.ndenumerate(aims):
                self._solver.changeCoeff(aim, tone, value)
        if not self._is_solved():
            self._solver.clearSolver()  # what it went on from was too ill-conditioned: from the start once more
            if not self._is_solved():
                status = self._solver.modelStatusToString(self._solver.getModelStatus())
                raise ProgramError(f"click: HiGHS ends with {status!r}: fewer tones (crowding) are less alike")
        return np.array(self._solver.getSolution().col_value)[:-1]

    def _is_solved(self) -> bool:
        self._solver.run()
        return bool(self._solver.getModelStatus() == highspy.HighsModelStatus.kOptimal)

    def _add_rows(self, rows: Array) -> None:
        self._add(np.column_stack([rows, np.zeros(len(rows))]), -1.0, 1.0)

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
