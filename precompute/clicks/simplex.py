"""Dense dual simplex: greatest c x subject to low <= A x <= high, for few unknowns and many two-sided rows.

Theory of operation
-------------------
A *basis* is as many independent rows as there are unknowns, each held at one of its limits: they are n equations,
whose solution is x. The prices y = c B^-1 say what the value gains as a limit moves. A basic row whose price is
positive belongs at its upper limit, one whose price is negative at its lower one; since every row has two limits,
any basis is made dual feasible by choosing sides, and no phase one is needed: a basis that was optimal for another
objective, other limits or fewer rows is a warm start. The value at a dual feasible basis is an upper bound.

One pivot: of the rows that x violates, the one with the greatest violation^2 / weight enters (dual devex weights,
Forrest and Goldfarb 1992; the reference frame is reset at each look at all rows). The ratio test lets prices pass
through zero as long as the bound still falls, moving these rows to their other side (bound flipping, Maros 2003). The
row that stops it leaves; the explicit inverse is updated by one rank-one term.

An inverse costs as much as tens of pivots, so it is seldom made new: before a result counts, one step of refinement
corrects x and the prices by what their equations leave, and only where that is not enough the inverse is made new.

Looking at all rows costs more than a pivot, and only rows near their limits can enter next. So pivots work on a *hot*
set of the rows nearest to their limits or beyond, chosen at each look at all rows.
"""

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from base.compiled import njit

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

HOT_ROWS = 150
PIVOTS_A_LOOK = 20
PIVOTS_AN_INVERSE = 400
TOLERANCE = 1e-7
"""Violation of a limit that is tolerated, relative to the scale of the row."""
_MOST_PIVOTS = 20_000
_SMALLEST_PIVOT = 1e-7
_EXACT = 1e-10
"""Error of an equation that is tolerated, relative to the scale of its row, or to the greatest cost."""
_BINS = 64


class Outcome(IntEnum):
    """How a run of pivots ended."""

    OPTIMAL = 0
    BELOW_FLOOR = 1
    """The bound fell to the floor, so the optimum is not above it."""
    FAILED = 2
    """Too many pivots, a singular basis, or no row that could leave: rounding, since the programs have solutions."""


# Loops stand for array expressions and assignments of slices here: those take seconds to compile.


@njit(nogil=True, cache=True, error_model="numpy")
def _take(rows: Array, chosen: Integers, out: Array) -> None:
    """Fill out (chosen, unknown) with the rows that are chosen."""
    for i in range(len(chosen)):
        for k in range(rows.shape[1]):
            out[i, k] = rows[chosen[i], k]


@njit(nogil=True, cache=True, error_model="numpy")
def _add(factor: float, direction: Array, out: Array) -> None:
    """Add factor times direction to out."""
    for i in range(len(out)):
        out[i] += factor * direction[i]


@njit(nogil=True, cache=True, error_model="numpy")
def _greatest(values: Array) -> float:
    """The greatest magnitude."""
    greatest = 0.0
    for value in values:
        greatest = max(greatest, abs(value))
    return greatest


@njit(nogil=True, cache=True, error_model="numpy")
def invert(rows: Array, basis: Integers, inverse: Array) -> bool:
    """Inverse of rows[basis] by Gauss and Jordan with row pivoting; False where it is singular."""
    n = len(basis)
    work = np.empty((n, n))
    _take(rows, basis, work)
    for i in range(n):
        for j in range(n):
            inverse[i, j] = 1.0 if i == j else 0.0
    for k in range(n):
        p = k
        for i in range(k + 1, n):
            if abs(work[i, k]) > abs(work[p, k]):
                p = i
        if abs(work[p, k]) < 1e-12:
            return False
        if p != k:
            for j in range(n):
                work[k, j], work[p, j] = work[p, j], work[k, j]
                inverse[k, j], inverse[p, j] = inverse[p, j], inverse[k, j]
        scale = 1.0 / work[k, k]
        for j in range(n):
            work[k, j] *= scale
            inverse[k, j] *= scale
        for i in range(n):
            factor = work[i, k]
            if i != k and factor != 0.0:
                for j in range(n):
                    work[i, j] -= factor * work[k, j]
                    inverse[i, j] -= factor * inverse[k, j]
    return True


@njit(nogil=True, cache=True, error_model="numpy")
def _choose_hot(
    value: Array, low: Array, high: Array, scale: Array, place: Integers, hot: Integers
) -> tuple[int, float]:
    """Fill `hot` with the nonbasic rows nearest to their limits or beyond; return their number and the worst excess.

    Excess: how far a row is beyond its nearer limit, as a fraction of its scale. A histogram of it says where to cut.
    """
    rows = len(value)
    counts = np.zeros(_BINS, np.int64)
    worst, worst_row = 0.0, -1
    for i in range(rows):
        if place[i] < 0:
            excess = max(value[i] - high[i], low[i] - value[i]) / scale[i]
            if excess > worst:
                worst, worst_row = excess, i
            counts[min(max(int((excess + 0.5) * 32), 0), _BINS - 1)] += 1
    cut, kept = _BINS - 1, counts[_BINS - 1]
    while cut > 0 and kept + counts[cut - 1] <= len(hot):
        cut -= 1
        kept += counts[cut]
    found = 0
    if worst_row >= 0:  # first: where too many rows are far beyond, the others are any of them
        hot[0], found = worst_row, 1
    for i in range(rows):
        if place[i] < 0 and i != worst_row and found < len(hot):
            excess = max(value[i] - high[i], low[i] - value[i]) / scale[i]
            if min(max(int((excess + 0.5) * 32), 0), _BINS - 1) >= cut:
                hot[found] = i
                found += 1
    return found, worst


@njit(nogil=True, cache=True, error_model="numpy")
def _choose_entering(value: Array, low: Array, high: Array, scale: Array, weight: Array, place: Integers) -> int:
    """The nonbasic row with the greatest excess^2 / weight, excesses relative to the scale; -1: no row is beyond."""
    entering, best = -1, 0.0
    for h in range(len(value)):
        excess = max(value[h] - high[h], low[h] - value[h]) / scale[h]
        if place[h] < 0 and excess > TOLERANCE and excess * excess > best * weight[h]:
            entering, best = h, excess * excess / weight[h]
    return entering


@njit(nogil=True, cache=True, error_model="numpy")
def _choose_leaving(
    alpha: Array,
    sign: float,
    slope: float,
    price: Array,
    target: Array,
    low: Array,
    high: Array,
    smallest: float,
    breaking: Integers,
    ratio: Array,
) -> tuple[int, float, int, int]:
    """Ratio test with bound flipping, for an entering row that is alpha (unknown,) times the basic rows.

    sign: 1.0 where the entering row is above its limits, -1.0 below; slope: by how much. target, low, high (unknown,):
    the limit of each basic row, and both of its limits; the targets of rows that flip are changed. breaking, ratio
    (unknown,) are overwritten. Returns the leaving basic row (-1 for none), the step of the prices, and from where to
    where `breaking` holds the rows that flipped.
    """
    n = len(alpha)
    # Breakpoints: how far the entering price may go until the price of a basic row changes its sign.
    breaks = 0
    for k in range(n):
        side = 1.0 if target[k] == high[k] else -1.0
        towards = side * sign * alpha[k]
        if towards > 1e-9:
            breaking[breaks], ratio[breaks] = k, max(side * price[k], 0.0) / towards
            breaks += 1
    all_breaks = breaks
    while breaks > 0:
        first = 0
        for b in range(1, breaks):
            if ratio[b] < ratio[first]:
                first = b
        for b in range(breaks):  # of ties, the largest pivot
            if ratio[b] <= ratio[first] + smallest and abs(alpha[breaking[b]]) > abs(alpha[breaking[first]]):
                first = b
        k, step = breaking[first], ratio[first]
        loss = abs(alpha[k]) * (high[k] - low[k])
        if slope <= loss or breaks == 1:
            return k, step, breaks, all_breaks
        # The bound still falls beyond this breakpoint: the basic row goes to its other limit.
        slope -= loss
        target[k] = low[k] if target[k] == high[k] else high[k]
        breaks -= 1
        breaking[first], ratio[first], breaking[breaks] = breaking[breaks], ratio[breaks], k
    return -1, 0.0, 0, 0


@njit(nogil=True, cache=True, error_model="numpy")
def _exchange(inverse: Array, alpha: Array, leaving: int, direction: Array) -> None:
    """Update the inverse for the exchange of one row, and fill direction (unknown,): how x moves with that row."""
    n = len(alpha)
    for j in range(n):
        direction[j] = inverse[j, leaving] / alpha[leaving]
    for j in range(n):
        for k in range(n):
            inverse[j, k] -= direction[j] * alpha[k]
        inverse[j, leaving] = direction[j]


@njit(nogil=True, cache=True, error_model="numpy")
def _fill_product(weight: Array, column: Array, out: Array) -> None:
    """Fill out (row,) with weight (unknown,) @ column (unknown, row), four unknowns at a time to spare the memory."""
    n = len(weight)
    for h in range(len(out)):
        out[h] = 0.0
    for k in range(0, n - 3, 4):
        a, b, c, d = weight[k], weight[k + 1], weight[k + 2], weight[k + 3]
        for h in range(len(out)):
            out[h] += (a * column[k, h] + b * column[k + 1, h]) + (c * column[k + 2, h] + d * column[k + 3, h])
    for k in range(n - n % 4, n):
        for h in range(len(out)):
            out[h] += weight[k] * column[k, h]


@njit(nogil=True, cache=True, error_model="numpy")
def _refine(basic: Array, inverse: Array, cost: Array, target: Array, scale: Array, x: Array, price: Array) -> bool:
    """Correct x and price (unknown,) by what their equations leave; False where the inverse is too far off for that.

    basic (unknown, unknown): the basic rows, which x holds at `target`.
    """
    n = len(x)
    left, own, step = np.dot(basic, x), np.dot(price, basic), np.empty(n)
    for k in range(n):
        left[k], own[k] = target[k] - left[k], cost[k] - own[k]
    np.dot(inverse, left, step)
    _add(1.0, step, x)
    np.dot(own, inverse, step)
    _add(1.0, step, price)
    np.dot(basic, x, left)
    np.dot(price, basic, own)
    most, is_exact = _EXACT * _greatest(cost), True
    for k in range(n):  # what is not a number is not exact
        is_exact &= abs(target[k] - left[k]) / scale[k] <= _EXACT and abs(cost[k] - own[k]) <= most
    return is_exact


@njit(nogil=True, cache=True, error_model="numpy")
def maximise(
    rows: Array,
    low: Array,
    high: Array,
    scale: Array,
    cost: Array,
    basis: Integers,
    place: Integers,
    inverse: Array,
    has_inverse: bool,
    floor: float,
    x: Array,
    price: Array,
    value: Array,
) -> tuple[int, int]:
    """Pivot until no row is beyond its limits by more than TOLERANCE of its scale, or the bound is at the floor.

    rows (row, unknown); low, high, scale (row,); cost (unknown,). basis (unknown,): the basic rows; place (row,):
    position of a row in the basis, -1 for none; inverse (unknown, unknown) of rows[basis], valid if `has_inverse`.
    x, price (unknown,), value (row,) are results. Returns an Outcome and the number of pivots.
    """
    n = len(basis)
    target, basic_low, basic_high = np.empty(n), low[basis], high[basis]  # target: the limit that holds each basic row
    alpha, direction, breaking, ratio = np.empty(n), np.empty(n), np.empty(n, np.int64), np.empty(n)
    hot = np.empty(HOT_ROWS, np.int64)
    basic = np.empty((n, n))
    smallest = 1e-10 * _greatest(cost)  # prices closer than this are equal
    pivots, since_inverse, is_exact = 0, PIVOTS_AN_INVERSE, False
    while True:
        if since_inverse >= PIVOTS_AN_INVERSE:
            if not has_inverse and not invert(rows, basis, inverse):
                return Outcome.FAILED, pivots
            is_exact, has_inverse, since_inverse = not has_inverse, False, 0
            np.dot(cost, inverse, price)
            for k in range(n):
                target[k] = basic_high[k] if price[k] >= 0 else basic_low[k]
            np.dot(inverse, target, x)
        # A look at all rows: which are beyond their limits or near them?
        np.dot(rows, x, value)
        found, worst = _choose_hot(value, low, high, scale, place, hot)
        is_below = np.dot(cost, x) <= floor
        if worst <= TOLERANCE or is_below:
            if is_exact:
                return Outcome.BELOW_FLOOR if is_below else Outcome.OPTIMAL, pivots
            _take(rows, basis, basic)
            if _refine(basic, inverse, cost, target, scale[basis], x, price):
                is_exact = True
            else:
                since_inverse = PIVOTS_AN_INVERSE
            continue
        chosen = hot[:found]
        hot_columns, hot_value, hot_place = np.empty((n, found)), value[chosen], place[chosen]
        for k in range(n):
            for h in range(found):
                hot_columns[k, h] = rows[chosen[h], k]
        hot_low, hot_high, hot_scale, weight = low[chosen], high[chosen], scale[chosen], np.ones(found)
        change = np.empty(found)
        for _ in range(PIVOTS_A_LOOK):
            if np.dot(cost, x) <= floor:
                break
            entering = _choose_entering(hot_value, hot_low, hot_high, hot_scale, weight, hot_place)
            if entering < 0:
                break
            if pivots >= _MOST_PIVOTS:
                return Outcome.FAILED, pivots
            row = chosen[entering]
            is_above = hot_value[entering] > hot_high[entering]
            sign, limit = (1.0, hot_high[entering]) if is_above else (-1.0, hot_low[entering])
            _fill_product(rows[row], inverse, alpha)
            slope = abs(hot_value[entering] - limit)
            leaving, step, first, last = _choose_leaving(
                alpha, sign, slope, price, target, basic_low, basic_high, smallest, breaking, ratio
            )
            if leaving < 0:
                return Outcome.FAILED, pivots
            is_exact = False
            # Where basic rows went to their other limits, x and the values follow.
            if last > first:
                for j in range(n):
                    direction[j] = 0.0
                for k in breaking[first:last]:
                    side = 1.0 if target[k] == basic_high[k] else -1.0
                    for j in range(n):
                        direction[j] += inverse[j, k] * side * (basic_high[k] - basic_low[k])
                _add(1.0, direction, x)
                _fill_product(direction, hot_columns, change)
                _add(1.0, change, hot_value)
            if abs(alpha[leaving]) < _SMALLEST_PIVOT and since_inverse > 0:
                since_inverse = PIVOTS_AN_INVERSE
                break
            # Prices, x and values along the direction in which only the leaving row moves.
            length = limit - hot_value[entering]
            pivot, entering_weight, left = alpha[leaving], weight[entering], basis[leaving]
            _add(-sign * step, alpha, price)
            price[leaving] = sign * step
            _exchange(inverse, alpha, leaving, direction)
            _add(length, direction, x)
            _fill_product(direction, hot_columns, change)
            for h in range(found):
                hot_value[h] += length * change[h]
                weight[h] = max(weight[h], change[h] * change[h] * entering_weight)
                if chosen[h] == left:
                    hot_place[h], weight[h] = -1, max(entering_weight / (pivot * pivot), 1.0)
            place[left], place[row], hot_place[entering] = -1, leaving, leaving
            basis[leaving], target[leaving] = row, limit
            basic_low[leaving], basic_high[leaving] = low[row], high[row]
            since_inverse += 1
            pivots += 1
