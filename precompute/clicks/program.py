"""Linear program of a click: weights of tones with the greatest response at given instants, within every limit.

Theory of operation
-------------------
Unknowns are the weights x of some 44 tones. Rows are two-sided and dense:

- aims: sums a x, one for each felt finger, what it feels at one instant. With one the objective is a x itself; with
  several it is a further unknown v that none of the sums may be less than, so that the weakest finger counts;
- drive rows, |row x| <= 1: amplitude (and slew) at every sample of the waveform. They hold every x within bounds;
- watched rows, |row x| <= limit: quiet fingers of all sampled plants at all instants, some 20 000 of them.

Few watched rows matter, so they are *generated*: solve with the rows that are in the pool, play the result through
all courses, and let in the highest peaks that pass the limit, or come near it in a course that does. Weights divided
by their worst violation keep to all limits, so each round gives a feasible value; the prices give an upper bound.
The rounds end when value and bound agree within the tolerance, or the bound falls below what is already had.

Rows found for one aim serve the next; rows far from their limits are taken out between aims, since a pivot costs as
many operations as there are rows in the pool. The dual simplex (`simplex.py`) starts where it ended. Where it fails,
which is rounding, HiGHS solves the pool, and `fallbacks` counts it.
"""

from dataclasses import astuple, dataclass, replace
from typing import Protocol

import highspy
import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from base.compiled import njit
from base.errors import TactableError
from precompute.clicks.simplex import Outcome, maximise

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Integers = NDArray[np.int64]

TOLERANCE = 1e-4
"""A bound this close, relative, counts as met: 0.001 dB."""
_PEAKS = 4
"""Most rows of one course that are added in one round."""
_ROUNDS = 60
_OVER = 1e-5
"""Relative violation that is tolerated, since courses are played in single precision."""
_LET_IN = 0.95
"""Fraction of the limit below which peaks of a violated course are not added."""
_NEAR = 0.7
"""Fraction of the limit below which a row counts as idle."""
_WORTH_PURGING = 40
"""Purge idle rows only when at least this many are idle."""
_LARGEST_VALUE = 1e4
"""Greater than any response in units of the threshold: the upper limit of the one-sided rows of several aims."""


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
class Basis:
    """The rows that hold an optimum at its limits: indices of aims and drive rows, and numbers of watched rows."""

    own: Integers
    watched: Integers


@dataclass(frozen=True)
class Optimum:
    """Weights (tone,) within every limit, their value, the upper bound, and the basis that a like one starts from."""

    weight: Array
    value: float
    bound: Bound
    basis: Basis | None = None


@dataclass(frozen=True)
class Effort:
    """What solving took: programs, pivots of the simplex, and runs of HiGHS in its place.

    programs: aims for which weights were sought, each with several rounds of rows.
    """

    programs: int = 0
    pivots: int = 0
    fallbacks: int = 0

    def __add__(self, other: "Effort") -> "Effort":
        return Effort(*(one + more for one, more in zip(astuple(self), astuple(other), strict=True)))


class Program:
    """Maximise the smallest of aims @ x subject to |drive x| <= 1 and |watched x| <= limit.

    drive (row, tone) must have as many independent rows as there are tones. x = 0 is within all limits, and so is any
    feasible x scaled down.
    """

    def __init__(self, drive: Array, watched: Watched, aims: int) -> None:
        self._drive, self._watched, self._aims = drive, watched, aims
        self._tones = drive.shape[1]
        self._extra = aims if aims > 1 else 0  # rows of several aims, and one unknown more
        self._unknowns = self._tones + (aims > 1)
        self._first_watched = self._extra + len(drive)
        self._pool = _Pool(self._unknowns)
        if aims > 1:
            self._pool.add(np.zeros((aims, self._unknowns)), 0.0, _LARGEST_VALUE)
        self._pool.add(self._with_value(drive), -1.0, 1.0)
        self._entered = np.zeros(watched.shape, np.bool_)
        self._order = np.zeros(0, np.int64)
        """Numbers of the watched rows in the pool."""
        self._limit = 1.0
        independent = scipy.linalg.qr(drive.T, mode="r", pivoting=True)[1][: self._tones] + self._extra
        self._first_basis = np.concatenate([independent, np.zeros(self._unknowns - self._tones, np.int64)])
        self._pool.start_from(self._first_basis)
        self._programs, self._fallbacks = 0, 0

    @property
    def rows(self) -> int:
        """Number of watched rows in the pool."""
        return len(self._order)

    @property
    def effort(self) -> Effort:
        """Effort of all programs solved so far."""
        return Effort(self._programs, self._pool.pivots, self._fallbacks)

    def set_limit(self, limit: float) -> None:
        """Change the limit of the watched courses."""
        self._limit = limit
        self._pool.limit_from(self._first_watched, limit)

    def add(self, numbers: Integers) -> None:
        """Add watched rows to the pool, given as course * samples + sample; none may be in it already."""
        self._pool.add(self._with_value(self._watched.rows(numbers)), -self._limit, self._limit)
        self._order = np.concatenate([self._order, numbers])
        self._entered.flat[numbers] = True

    def maximise(
        self, aims: Array, floor: float = 0.0, tolerance: float = TOLERANCE, start: Basis | None = None
    ) -> Optimum:
        """The best weights for aims (aim, tone), to `tolerance` relative; given up once the bound is below `floor`.

        start: the basis of an earlier optimum that is thought to be near; None: that of the last program.
        """
        self._purge()
        if start is not None:
            self._start_from(start)
        self._programs += 1
        cost = self._aim_at(aims)
        best = Optimum(np.zeros(self._tones), 0.0, UNBOUNDED)
        for _ in range(_ROUNDS):
            weight, bound = self._solve(cost, floor)
            least = bound.at(self._limit)
            course = self._watched.play(weight)
            violation = max(float(course.max(initial=0.0)) / self._limit, float(np.abs(self._drive @ weight).max()))
            value = float((aims @ weight).min()) / max(1.0, violation)
            is_better = value >= best.value
            best = Optimum(weight / max(1.0, violation), value, bound) if is_better else replace(best, bound=bound)
            if best.value >= least * (1 - tolerance) or least <= floor or not self._add_violated(course):
                break
        return replace(best, basis=self._basis())

    def _basis(self) -> Basis:
        basis = self._pool.basis
        is_own = basis < self._first_watched
        return Basis(basis[is_own], self._order[basis[~is_own] - self._first_watched])

    def _start_from(self, start: Basis) -> None:
        """Start from a basis, whose watched rows may have been deleted meanwhile."""
        missing = start.watched[~self._entered.flat[start.watched]]
        if len(missing):
            self.add(missing)
        where = np.argsort(self._order)
        rows = where[np.searchsorted(self._order, start.watched, sorter=where)]
        self._pool.start_from(np.concatenate([start.own, rows + self._first_watched]))

    def _with_value(self, rows: Array) -> Array:
        """Rows (row, unknown) of rows (row, tone): the value of several aims has no part in them."""
        return np.column_stack([rows, np.zeros(len(rows))]) if self._extra else rows

    def _aim_at(self, aims: Array) -> Array:
        """The objective (unknown,) of aims (aim, tone), whose rows it changes where there are several."""
        if self._aims == 1:
            return np.ascontiguousarray(aims[0])
        self._pool.rows[: self._aims] = np.column_stack([aims, np.full(self._aims, -1.0)])
        self._pool.has_inverse = False
        return np.append(np.zeros(self._tones), 1.0)

    def _solve(self, cost: Array, floor: float) -> tuple[Array, Bound]:
        """The best weights for the rows in the pool, and the bound that their prices prove."""
        outcome = self._pool.maximise(cost, floor)
        if outcome is Outcome.FAILED:
            self._pool.start_from(self._first_basis)
            outcome = self._pool.maximise(cost, floor)
        if outcome is Outcome.FAILED:
            self._fallbacks += 1
            x, price = _solve_with_highs(self._pool, cost)
            self._pool.start_from(self._first_basis)
        else:
            x, price = self._pool.x, self._pool.prices()
        size = np.abs(price[self._extra :])
        drive = len(self._drive)
        open_side = float(np.maximum(price[: self._extra], 0.0).sum()) * _LARGEST_VALUE
        return x[: self._tones].copy(), Bound(float(size[:drive].sum()) + open_side, float(size[drive:].sum()))

    def _add_violated(self, course: Single) -> bool:
        """Add the highest peaks of every course that exceeds the limit; False if none does."""
        numbers = np.empty(_PEAKS * len(course), np.int64)
        found: int = _pick_peaks(course, self._entered, self._limit * _LET_IN, self._limit * (1 + _OVER), numbers)
        if found:
            self.add(numbers[:found].copy())
        return found > 0

    def _purge(self) -> None:
        """Delete the watched rows that are far from the limit and not basic."""
        first = self._first_watched
        idle = np.abs(self._pool.value[first:]) < _NEAR * self._limit
        idle &= self._pool.place[first:] < 0
        if np.count_nonzero(idle) >= _WORTH_PURGING:
            self._entered.flat[self._order[idle]] = False
            self._order = self._order[~idle]
            self._pool.keep(np.concatenate([np.ones(first, np.bool_), ~idle]))


class _Pool:
    """Rows of a program with its basis and last solution, as arrays (row, ...) that grow."""

    def __init__(self, unknowns: int) -> None:
        self.rows = np.zeros((0, unknowns))
        self.low = self.high = self.value = np.zeros(0)
        self.place = np.zeros(0, np.int64)
        self.basis = np.zeros(unknowns, np.int64)
        self.inverse = np.zeros((unknowns, unknowns))
        self.x, self.price = np.zeros(unknowns), np.zeros(unknowns)
        self.has_inverse = False
        self.pivots = 0

    def add(self, rows: Array, low: float, high: float) -> None:
        """Add rows (row, unknown) with the same limits."""
        count = len(rows)
        self.rows = np.concatenate([self.rows, rows])
        self.low = np.concatenate([self.low, np.full(count, low)])
        self.high = np.concatenate([self.high, np.full(count, high)])
        self.value = np.concatenate([self.value, np.zeros(count)])
        self.place = np.concatenate([self.place, np.full(count, -1)])

    def keep(self, kept: NDArray[np.bool_]) -> None:
        """Keep only the rows `kept` (row,), which must include every basic row."""
        number = np.cumsum(kept) - 1
        self.basis = number[self.basis]
        self.rows, self.low, self.high = self.rows[kept], self.low[kept], self.high[kept]
        self.value, self.place = self.value[kept], self.place[kept]

    def limit_from(self, first: int, limit: float) -> None:
        """Change the limits of all rows from `first` on."""
        self.low[first:], self.high[first:] = -limit, limit

    def start_from(self, basis: Integers) -> None:
        """Begin with the basis of these rows (unknown,)."""
        self.basis[:] = basis
        self.place[:] = -1
        self.place[basis] = np.arange(len(basis))
        self.has_inverse = False

    def maximise(self, cost: Array, floor: float) -> Outcome:
        """Solve for cost (unknown,) from the present basis: x, price, value and basis change."""
        scale = np.where(self.high < _LARGEST_VALUE, self.high, 1.0)
        outcome, pivots = maximise(
            self.rows,
            self.low,
            self.high,
            scale,
            cost,
            self.basis,
            self.place,
            self.inverse,
            self.has_inverse,
            floor,
            self.x,
            self.price,
            self.value,
        )
        self.has_inverse = outcome != Outcome.FAILED
        self.pivots += pivots
        return Outcome(outcome)

    def prices(self) -> Array:
        """Dual prices (row,): derivative of the value by the row's limit; 0 for rows that are not basic."""
        price = np.zeros(len(self.rows))
        price[self.basis] = self.price
        return price


@njit(nogil=True, cache=True)
def _pick_peaks(course: Single, entered: NDArray[np.bool_], low: float, limit: float, numbers: Integers) -> int:
    """Pick the highest local peaks above `low` that are not in the pool, of each course that exceeds `limit`.

    course, entered (course, sample); numbers are filled with course * samples + sample, at most _PEAKS a course.
    Returns how many there are.
    """
    found, samples = 0, course.shape[1]
    height = np.empty(_PEAKS)
    for i in range(len(course)):
        if course[i].max() <= limit:
            continue
        first = found
        for t in range(samples):
            size = course[i, t]
            is_peak = (t == 0 or size >= course[i, t - 1]) and (t == samples - 1 or size >= course[i, t + 1])
            if size <= low or not is_peak or entered[i, t]:
                continue
            if found - first < _PEAKS:
                height[found - first], numbers[found] = size, i * samples + t
                found += 1
            else:
                lowest = height.argmin()
                if size > height[lowest]:
                    height[lowest], numbers[first + lowest] = size, i * samples + t
    return found


def _solve_with_highs(pool: _Pool, cost: Array) -> tuple[Array, Array]:
    """Solve the pool with HiGHS: unknowns (unknown,) and prices (row,)."""
    solver = highspy.Highs()  # type: ignore[no-untyped-call]  # highspy has stubs for part of itself
    for option, setting in (("output_flag", False), ("threads", 1)):
        solver.setOptionValue(option, setting)
    unknowns, endless = len(cost), np.full(len(cost), highspy.kHighsInf)
    solver.addVars(unknowns, -endless, endless)
    solver.changeObjectiveSense(highspy.ObjSense.kMaximize)
    columns = np.arange(unknowns, dtype=np.int32)
    solver.changeColsCost(unknowns, columns, cost)
    starts = np.arange(0, pool.rows.size, unknowns, dtype=np.int32)
    solver.addRows(
        len(pool.rows), pool.low, pool.high, pool.rows.size, starts, np.tile(columns, len(pool.rows)), pool.rows.ravel()
    )
    solver.run()
    if solver.getModelStatus() != highspy.HighsModelStatus.kOptimal:
        status = solver.modelStatusToString(solver.getModelStatus())
        raise ProgramError(f"click: HiGHS ends with {status!r}: fewer tones (crowding) are less alike")
    solution = solver.getSolution()
    return np.array(solution.col_value), np.array(solution.row_dual)
