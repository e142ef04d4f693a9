"""A device to better places for its actuators: the worst of all states of one felt and one quiet finger made best.

A search, not a proof: all placements of a coarse grid are screened (precompute.two_fingers), the best few are moved in
ever smaller steps while that helps, and what comes out is judged by the entries that a table would hold.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import comb

import numpy as np
from numpy.typing import NDArray

from engine.device import Device
from precompute.touches import sample_touches
from precompute.two_fingers import TwoFingers, screen_two_fingers, solve_two_fingers

Array = NDArray[np.float64]
Places = tuple[float, ...]
Told = Callable[[float], None]

MOST = 300
"""Placements screened for each number of actuators."""
MARGIN, APART = 0.02, 0.05
"""Fractions of the bar's length that an actuator keeps from its ends, and from the next one. ESTIMATE: their size."""
_STEP_HZ, _FINE_STEP_HZ = 4.0, 2.0
_STARTS, _MOVES, _FINEST = 4, 12, 0.005
"""Placements moved, rounds of moves of each, and the smallest step as a fraction of the bar's length."""
_JUDGED = 2
_SCREENING, _MOVING = 0.3, 0.6
"""Fractions done after these parts."""


@dataclass(frozen=True, eq=False)
class Placement:
    """Positions from the bar's start, rising, whose they are ("found", "as described", "even"), and what they give."""

    name: str
    position_m: Places
    fingers: TwoFingers


@dataclass(frozen=True, eq=False)
class PlacementSearch:
    """What was looked at for one number of actuators, and the placements judged, the best first.

    screened_m (placement, actuator); screened_db (placement,): worst contrast by the screening, NaN where a level is
    out of reach. moved: placements looked at besides.
    """

    screened_m: Array
    screened_db: Array
    moved: int
    judged: tuple[Placement, ...]

    @property
    def count(self) -> int:
        """Number of actuators."""
        return int(self.screened_m.shape[1])


def with_actuators_at(device: Device, position_m: Sequence[float]) -> Device:
    """The device with an actuator at each position, rising: its own in their order, repeated where there are more."""
    own, count = sorted(device.actuators, key=lambda actuator: actuator.position_m), len(position_m)
    chosen = [own[i * len(own) // count] for i in range(count)]
    placed = [
        replace(actuator, name=f"actuator {i + 1}", position_m=at)
        for i, (actuator, at) in enumerate(zip(chosen, sorted(position_m), strict=True))
    ]
    return replace(device, actuators=tuple(placed))


def even_places(device: Device, count: int) -> Places:
    """The middles of so many equal parts of the bar."""
    return tuple(((np.arange(count) + 0.5) / count * device.bar.length_m).tolist())


def own_places(device: Device) -> Places:
    """Where the device has its actuators, rising."""
    return tuple(sorted(actuator.position_m for actuator in device.actuators))


def grid_of(device: Device, count: int, most: int) -> tuple[list[Places], float]:
    """All placements of the finest even grid that has at most `most` of them, and its step in metres."""
    low_m, high_m = MARGIN * device.bar.length_m, (1 - MARGIN) * device.bar.length_m
    points = count + 1
    while comb(points + 1, count) <= most:
        points += 1
    grid_m = np.linspace(low_m, high_m, points).tolist()
    return [at for at in itertools.combinations(grid_m, count) if _is_buildable(device, at)], grid_m[1] - grid_m[0]


def search_placement(device: Device, count: int, wanted_db: float, most: int, told: Told) -> PlacementSearch:
    """Search where `count` actuators go for the best worst state at `wanted_db`; `told` the fraction done."""
    touches = sample_touches(device)

    def screen(at: Places, step_hz: float) -> TwoFingers:
        return screen_two_fingers(with_actuators_at(device, at), touches, wanted_db, step_hz)

    grid, step_m = grid_of(device, count, most)
    screened = list[TwoFingers]()
    for at in grid:
        screened.append(screen(at, _STEP_HZ))
        told(_SCREENING * len(screened) / len(grid))
    order = sorted(range(len(grid)), key=lambda i: screened[i].rank, reverse=True)
    climber = _Climber(device, lambda at: screen(at, _FINE_STEP_HZ))
    starts = list(_distinct([grid[i] for i in order], step_m))
    climbed = set[Places]()
    for k, start in enumerate(starts):
        climbed.add(climber.climb(start, step_m))
        told(_SCREENING + (_MOVING - _SCREENING) * (k + 1) / len(starts))
    best = sorted(climbed, key=lambda at: climber.of(at).rank, reverse=True)[:_JUDGED]
    return PlacementSearch(
        screened_m=np.array(grid),
        screened_db=np.array([found.worst_db if found.is_reached else np.nan for found in screened]),
        moved=len(climber.seen),
        judged=tuple(_judge(device, best, wanted_db, lambda done: told(_MOVING + (1 - _MOVING) * done))),
    )


class _Climber:
    """Moves one actuator at a time, half the step when no move helps; remembers what it has looked at."""

    def __init__(self, device: Device, screen: Callable[[Places], TwoFingers]) -> None:
        self._device, self._screen = device, screen
        self.seen: dict[Places, TwoFingers] = {}

    def of(self, at: Places) -> TwoFingers:
        if at not in self.seen:
            self.seen[at] = self._screen(at)
        return self.seen[at]

    def climb(self, start: Places, step_m: float) -> Places:
        at, least_m = start, _FINEST * self._device.bar.length_m
        for _ in range(_MOVES):
            step_m /= 2
            if step_m < least_m:
                break
            moves = [at, *self._moves(at, step_m)]
            best = max(moves, key=lambda move: self.of(move).rank)
            step_m *= 1 if best == at else 2
            at = best
        return at

    def _moves(self, at: Places, step_m: float) -> Iterator[Places]:
        for i, by_m in itertools.product(range(len(at)), (-step_m, step_m)):
            moved = (*at[:i], round(at[i] + by_m, 6), *at[i + 1 :])
            if _is_buildable(self._device, moved):
                yield moved


def _distinct(ordered: Sequence[Places], step_m: float) -> Iterator[Places]:
    """The first few that are not next to one another on the grid."""
    chosen = list[Places]()
    for at in ordered:
        if all(np.abs(np.subtract(at, other)).max() > 1.5 * step_m for other in chosen):
            chosen.append(at)
            yield at
        if len(chosen) == _STARTS:
            return


def _is_buildable(device: Device, at: Places) -> bool:
    length_m, slack_m = device.bar.length_m, 1e-6
    gaps_m = np.diff(at)
    inside = at[0] >= MARGIN * length_m - slack_m and at[-1] <= (1 - MARGIN) * length_m + slack_m
    return bool(inside and (gaps_m >= APART * length_m - slack_m).all())


def _judge(device: Device, found: Sequence[Places], wanted_db: float, told: Told) -> list[Placement]:
    """The best of those found, the device's own and the even placement, by what a table would hold; best first."""
    count = len(found[0])
    named = [("found", at) for at in found] + [("even", even_places(device, count))]
    if count == len(device.actuators):
        named.append(("as described", own_places(device)))
    judged = list[Placement]()
    for name, at in named:
        judged.append(Placement(name, at, solve_two_fingers(with_actuators_at(device, at), wanted_db)))
        told(len(judged) / len(named))
    judged.sort(key=lambda placement: placement.fingers.rank, reverse=True)
    first = next(placement for placement in judged if placement.name == "found")
    return [placement for placement in judged if placement is first or placement.name != "found"]
