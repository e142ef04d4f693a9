"""Resolution: how well actuators tell two fingers apart as zones become narrower, which the paper leaves open."""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

from base.arrays import Array
from base.points import order_of, rows_of_squares
from engine.device import Device
from engine.device.surface_description import equal_zones
from precompute.model.assembly import assemble
from precompute.parallel.pool import WorkerPool
from precompute.predict.untouched import greatest_factors
from precompute.studies.placement_search import TwoFingers, solve_two_fingers, with_actuators_at


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
