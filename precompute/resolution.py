"""Zones made narrower to what actuators still tell apart: the question that the paper leaves open."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from engine.device import Device, Zone
from engine.device_file import ROMAN
from precompute.assembly import assemble
from precompute.placement import with_actuators_at
from precompute.two_fingers import TwoFingers, solve_two_fingers
from precompute.untouched_optimum import greatest_factors

Array = NDArray[np.float64]

MOST_ZONES = len(ROMAN)


@dataclass(frozen=True, eq=False)
class Resolved:
    """A bar with actuators at position_m and so many equal zones.

    fingers: contrasts of every two of them. factor (zone,): the greatest localized factor of each alone, untouched.
    """

    position_m: tuple[float, ...]
    zones: int
    zone_length_m: float
    fingers: TwoFingers
    factor: Array


def with_equal_zones(device: Device, count: int) -> Device:
    """The device with so many equal zones, named by Roman numerals."""
    edges = np.linspace(0.0, device.bar.length_m, count + 1).tolist()
    named = [Zone(name, a, b) for name, (a, b) in zip(ROMAN, itertools.pairwise(edges), strict=False)]
    return replace(device, zones=tuple(named))


def study_resolution(
    device: Device,
    placements: Sequence[tuple[float, ...]],
    zones: Sequence[int],
    wanted_db: float,
    told: Callable[[float], None],
) -> list[Resolved]:
    """Every number of zones for every placement (positions in metres), in this order; `told` the fraction done."""
    wanted = [(at, count) for at in placements for count in zones]
    work, found = sum(count * (count - 1) for _, count in wanted), list[Resolved]()
    done = 0
    for at, count in wanted:
        changed = with_equal_zones(with_actuators_at(device, at), count)
        found.append(
            Resolved(
                position_m=tuple(sorted(at)),
                zones=count,
                zone_length_m=device.bar.length_m / count,
                fingers=solve_two_fingers(changed, wanted_db),
                factor=greatest_factors(assemble(changed)),
            )
        )
        done += count * (count - 1)
        told(done / work)
    return found
