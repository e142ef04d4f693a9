"""Search for actuator places that maximise the contrast of the worst state of one felt and one quiet finger.

A search, not a proof. All placements of a coarse grid are screened (`screen_two_fingers`). The best few of them, the
even placement and the device's own are moved in ever smaller steps while that helps. The ends are evaluated by
the drives that a run would solve, and "found" is the best placement that was evaluated, wherever its search began:
screening and evaluation need not agree, so an end of the search can be worse than a start. `placed_text` is the device
file of a placement.

`study_resolution` computes how well actuators tell two fingers apart as zones become narrower, which the paper leaves
open.
"""

import copy
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import comb

import numpy as np
import tomlkit

from base.arrays import Array, Points, even_points
from base.points import is_within, order_of, point_at, rows_of_squares, sides_of
from engine.device import Device
from engine.device.surface_description import equal_zones
from engine.steady.steady_solver import SteadySolver
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.parallel.pool import WorkerPool
from precompute.predict.at_positions import SteadyDesigner
from precompute.predict.untouched import greatest_factors
from precompute.sampling.steady_modes import steady_modes

Pair = tuple[int, int]

_MODES = 24  # of the screening: as many as the page's moving bar has; more change its levels by < 0.05 dB


@dataclass(frozen=True)
class TwoFingers:
    """Expected contrast and level of the felt finger, each (felt zone, quiet zone) in dB; NaN on the diagonal.

    Where full scale does not reach `wanted_db`, the level is the greatest there is and the contrast that of this drive.
    """

    wanted_db: float
    contrast_db: Array
    level_db: Array

    @cached_property
    def is_reached(self) -> bool:
        """Whether every felt finger gets the wanted level."""
        return bool(np.nanmin(self.level_db) >= self.wanted_db - 1e-3)

    @cached_property
    def worst_db(self) -> float:
        """Contrast of the worst pair."""
        return float(np.nanmin(self.contrast_db))

    @cached_property
    def rank(self) -> tuple[bool, float]:
        """Greater is better: the level first, then the worst contrast; where the level is missed, by how much."""
        return self.is_reached, self.worst_db if self.is_reached else float(np.nanmin(self.level_db))


def finger_pairs(device: Device) -> list[Pair]:
    """Every felt and quiet zone (indices); those with the same fingers one after another."""
    return [pair for two in itertools.combinations(range(len(device.zones)), 2) for pair in (two, two[::-1])]


def solve_two_fingers(device: Device, wanted_db: float) -> TwoFingers:
    """Contrasts of the drives that a run solves for these fingers at `wanted_db`."""
    return _contrasts(device, SteadyDesigner(device).solver, wanted_db)


def screen_two_fingers(device: Device, wanted_db: float, step_hz: float) -> TwoFingers:
    """The same estimated quickly, from few modes and frequencies `step_hz` apart."""
    coarse = replace(device, sweep=replace(device.sweep, step_hz=step_hz))
    modes = steady_modes(compute_basis(assemble(coarse), _MODES))
    return _contrasts(coarse, SteadySolver(coarse, modes), wanted_db)


def _contrasts(device: Device, solver: SteadySolver, wanted_db: float) -> TwoFingers:
    middle_m = [(zone.start_m + zone.stop_m) / 2 for zone in device.zones]
    contrast_db, level_db = (np.full((len(middle_m),) * 2, np.nan) for _ in range(2))
    for felt, quiet in finger_pairs(device):
        drive = solver.solve([middle_m[felt], middle_m[quiet]], [True, False], wanted_db)
        contrast_db[felt, quiet], level_db[felt, quiet] = drive.expected_contrast_db, drive.weakest_felt_db
    return TwoFingers(wanted_db, contrast_db, level_db)


Places = tuple[complex, ...]
Progress = Callable[[float], None]

MARGIN, APART = 0.02, 0.05  # of a side that an actuator keeps from its ends, of the length from the next. ESTIMATE
_STEP_HZ, _FINE_STEP_HZ = 4.0, 2.0
_STARTS, _MOVES, _FINEST = 4, 12, 0.005  # placements moved, rounds of moves, smallest step as a fraction of the length
_WAYS = (1.0, -1.0, 1j, -1j)  # directions of a move; those across a bar leave it
_EVALUATED = 2
_SCREENING, _MOVING = 0.3, 0.6  # fractions done after these parts


@dataclass(frozen=True, eq=False)
class Placement:
    """Points in order (base.points), with their name ("found", "as described", "even") and contrasts."""

    name: str
    position_m: Places
    fingers: TwoFingers


@dataclass(frozen=True, eq=False)
class PlacementSearch:
    """The search for one number of actuators: what was screened, and the placements evaluated, the best first.

    screened_m (placement, actuator); screened_db (placement,): worst contrast by the screening, NaN where a level is
    out of reach. moved: placements looked at besides.
    """

    screened_m: Points
    screened_db: Array
    moved: int
    evaluated: tuple[Placement, ...]

    @property
    def count(self) -> int:
        """Number of actuators."""
        return int(self.screened_m.shape[1])


def with_actuators_at(device: Device, position_m: Sequence[complex]) -> Device:
    """The device with an actuator at each position, rising: its own in their order, repeated where there are more."""
    own, count = sorted(device.actuators, key=lambda actuator: order_of(actuator.position_m)), len(position_m)
    chosen = [own[i * len(own) // count] for i in range(count)]
    placed = [
        replace(actuator, name=f"actuator {i + 1}", position_m=at)
        for i, (actuator, at) in enumerate(zip(chosen, sorted(position_m, key=order_of), strict=True))
    ]
    return replace(device, actuators=tuple(placed))


def even_places(device: Device, count: int) -> Places:
    """The middles of `count` nearly equal parts: of the bar, or of a plate in rows along it that are as far apart."""
    corner_m = device.surface.corner_m
    rows = max(1, round((count * corner_m.imag / corner_m.real) ** 0.5))
    lengths = [(count + row) // rows for row in range(rows)]
    parts = [((k + 0.5) / n, (row + 0.5) / rows) for row, n in enumerate(lengths) for k in range(n)]
    return tuple(sorted((point_at(corner_m, *part) for part in parts), key=order_of))


def own_places(device: Device) -> Places:
    """Points of the device's own actuators, in order."""
    return tuple(sorted((actuator.position_m for actuator in device.actuators), key=order_of))


def grid_of(device: Device, count: int, most: int) -> tuple[list[Places], float]:
    """All placements of the finest even grid that has at most `most` of them, and its step in metres."""
    corner_m = device.surface.corner_m

    def across(along: int) -> int:
        return max(1 + (corner_m.imag > 0), round(along * corner_m.imag / corner_m.real))

    along = 2
    while along * across(along) <= count or comb((along + 1) * across(along + 1), count) <= most:
        along += 1
    grid_m = even_points(MARGIN * corner_m, (1 - MARGIN) * corner_m, along, across(along)).tolist()
    step_m = abs(grid_m[1] - grid_m[0])
    ordered = itertools.combinations(sorted(grid_m, key=order_of), count)
    return [at for at in ordered if _is_buildable(device, at)], step_m


def search_placement(
    device: Device, count: int, wanted_db: float, most: int, on_progress: Progress, pool: WorkerPool | None = None
) -> PlacementSearch:
    """Search where `count` actuators go for the best worst state at `wanted_db`.

    This process and the workers of `pool` share the work; `on_progress` is called with the fraction done.
    """
    solve = (pool or WorkerPool(0)).solve_in_order
    grid, step_m = grid_of(device, count, most)
    screened = solve(partial(_screen, device, wanted_db, _STEP_HZ), grid, lambda done: on_progress(_SCREENING * done))
    order = sorted(range(len(grid)), key=lambda i: screened[i].rank, reverse=True)
    known = _known(device, count)
    starts = list(dict.fromkeys([*_distinct([grid[i] for i in order], step_m), *known.values()]))
    climb = partial(_climb, device, wanted_db, step_m)
    climbed = solve(climb, starts, lambda done: on_progress(_SCREENING + (_MOVING - _SCREENING) * done))
    best = sorted({end.position_m: end.rank for end in climbed}.items(), key=lambda item: item[1], reverse=True)
    named = [*(("found", at) for at, _ in best[:_EVALUATED]), *known.items()]
    evaluate = partial(_evaluate, device, wanted_db)
    fingers = solve(evaluate, [at for _, at in named], lambda done: on_progress(_MOVING + (1 - _MOVING) * done))
    return PlacementSearch(
        screened_m=np.array(grid),
        screened_db=np.array([found.worst_db if found.is_reached else np.nan for found in screened]),
        moved=sum(end.looked_at for end in climbed),
        evaluated=_ranked([Placement(name, at, found) for (name, at), found in zip(named, fingers, strict=True)]),
    )


@dataclass(frozen=True)
class Climbed:
    """The end of a climb, its rank, and how many placements the climb looked at."""

    position_m: Places
    rank: tuple[bool, float]
    looked_at: int


def _screen(device: Device, wanted_db: float, step_hz: float, at: Places) -> TwoFingers:
    return screen_two_fingers(with_actuators_at(device, at), wanted_db, step_hz)


def _evaluate(device: Device, wanted_db: float, at: Places) -> TwoFingers:
    return solve_two_fingers(with_actuators_at(device, at), wanted_db)


def _climb(device: Device, wanted_db: float, step_m: float, start: Places) -> Climbed:
    """Move one actuator at a time to its best neighbouring place; halve the step when no move helps."""
    look = partial(_screen, device, wanted_db, _FINE_STEP_HZ)
    ranks, at = {start: look(start).rank}, start
    for _ in range(_MOVES):
        step_m /= 2
        if step_m < _FINEST * device.surface.length_m:
            break
        moves = list(_moves(device, at, step_m))
        ranks |= {move: look(move).rank for move in moves if move not in ranks}
        best = max([at, *moves], key=ranks.__getitem__)
        step_m *= 1 if best == at else 2
        at = best
    return Climbed(at, ranks[at], len(ranks))


def _moves(device: Device, at: Places, step_m: float) -> Iterator[Places]:
    for i, way in itertools.product(range(len(at)), _WAYS):
        moved = tuple(sorted((*at[:i], _rounded(at[i] + step_m * way), *at[i + 1 :]), key=order_of))
        if _is_buildable(device, moved):
            yield moved


def _rounded(at_m: complex) -> complex:
    return complex(round(at_m.real, 6), round(at_m.imag, 6)) if isinstance(at_m, complex) else round(at_m, 6)


def _distinct(ordered: Sequence[Places], step_m: float) -> Iterator[Places]:
    """The first few placements that are not neighbours on the grid."""
    chosen = list[Places]()
    for at in ordered:
        if all(np.abs(np.subtract(at, other)).max() > 1.5 * step_m for other in chosen):
            chosen.append(at)
            yield at
        if len(chosen) == _STARTS:
            return


def _is_buildable(device: Device, at: Places) -> bool:
    corner_m, slack_m = device.surface.corner_m, 1e-6
    clamped_m = max(actuator.clamp_m for actuator in device.actuators)
    apart_m = max(APART * corner_m.real, clamped_m + MARGIN * corner_m.real if clamped_m else 0.0) - slack_m
    inside = all(is_within(each_m - MARGIN * corner_m, (1 - 2 * MARGIN) * corner_m, slack_m) for each_m in at)
    return inside and all(abs(one_m - other_m) >= apart_m for one_m, other_m in itertools.combinations(at, 2))


def _known(device: Device, count: int) -> dict[str, Places]:
    """The even placement and, where the device has as many actuators, its own, by name."""
    own = {"as described": own_places(device)} if count == len(device.actuators) else {}
    return {"even": even_places(device, count), **own}


def _ranked(evaluated: Sequence[Placement]) -> tuple[Placement, ...]:
    """The best of all, named "found", then the known placements by rank."""
    ordered = sorted(evaluated, key=lambda placement: placement.fingers.rank, reverse=True)
    known = (placement for placement in ordered if placement.name != "found")
    return replace(ordered[0], name="found"), *known


def placed_text(device: Device, name: str, position_m: Sequence[complex]) -> str:
    """Text of the device called `name` with an actuator at each position, in metres; comments and order are kept.

    The positions are no longer marked as estimates: the study chose them. Where there are more positions than
    actuators, actuators are repeated, as `with_actuators_at` does. A calibration is left out, since its covariance is
    that of the actuators where they were.
    """
    document = tomlkit.parse(device.text)
    rank = sorted(range(len(device.actuators)), key=lambda i: order_of(device.actuators[i].position_m))
    own, count = document["actuator"], len(position_m)
    placed = tomlkit.aot()
    for i, actuator in enumerate(with_actuators_at(device, position_m).actuators):
        table = copy.deepcopy(own[rank[i * len(rank) // count]])
        sides = [f"{1e3 * side_m:.3f} mm" for side_m in sides_of(actuator.position_m) if not math.isnan(side_m)]
        table["name"], table["position"] = actuator.name, sides if len(sides) > 1 else sides[0]
        if "position" in table.get("inferred", []):
            table["inferred"].remove("position")
        placed.append(table)
    document["actuator"], document["name"] = placed, name
    document.pop("calibration", None)
    return tomlkit.dumps(document)


@dataclass(frozen=True, eq=False)
class Resolved:
    """A surface with actuators at position_m and `zones` equal zones.

    zone_width_m: the length of a zone of a bar; on a plate the side of a square of its area. fingers: contrasts of
    every two of them. factor (zone,): the greatest localized factor of each alone, untouched.
    """

    position_m: tuple[complex, ...]
    zones: int
    zone_width_m: float
    fingers: TwoFingers
    factor: Array


def with_equal_zones(device: Device, count: int) -> Device:
    """The device with `count` equal zones, at most 16 as in a device file, named by Roman numerals."""
    corner_m = device.surface.corner_m
    rows = rows_of_squares(count, corner_m) if isinstance(corner_m, complex) else 1
    return replace(device, zones=equal_zones(device.surface, count // rows, rows))


def study_resolution(
    device: Device,
    placements: Sequence[tuple[complex, ...]],
    zones: Sequence[int],
    wanted_db: float,
    on_progress: Callable[[float], None],
    pool: WorkerPool | None = None,
) -> list[Resolved]:
    """The contrasts of every placement (positions in metres) with every number of zones, in this order.

    This process and the workers of `pool` share the work; `on_progress` is called with the fraction done.
    """
    jobs = list(itertools.product(placements, zones))
    slowest_first = sorted(jobs, key=lambda job: -len(job[0]) * job[1] ** 2)
    found = (pool or WorkerPool(0)).solve_in_order(partial(_resolve, device, wanted_db), slowest_first, on_progress)
    by_job = dict(zip(slowest_first, found, strict=True))
    return [by_job[job] for job in jobs]


def _resolve(device: Device, wanted_db: float, job: tuple[tuple[complex, ...], int]) -> Resolved:
    position_m, zones = job
    changed = with_equal_zones(with_actuators_at(device, position_m), zones)
    span_m = changed.zones[0].stop_m - changed.zones[0].start_m
    return Resolved(
        position_m=tuple(sorted(position_m, key=order_of)),
        zones=zones,
        zone_width_m=math.sqrt(span_m.real * span_m.imag) if isinstance(span_m, complex) else span_m,
        fingers=solve_two_fingers(changed, wanted_db),
        factor=greatest_factors(assemble(changed)),
    )
