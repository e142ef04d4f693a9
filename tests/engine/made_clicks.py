"""Clicks made by hand: the waveform says which placement it is for, the figures are all alike."""

from collections.abc import Iterable, Sequence
from functools import cache
from math import inf

import numpy as np

from engine.device import Device
from engine.table import ClickEntry, Clicks
from engine.table.clicks import ClickFinger, LevelSpread
from engine.touch import Placement
from engine.touch.placement import Key, Places
from firmware_link.protocol.basis import Basis, BasisSet

PITCH_M, TOLERANCE_M = 28e-3, 15e-3
"""On the published bar the middle of every zone is one of these places."""
_NUMBERS = 30_000


@cache
def basis_of(actuators: int, *counts: int) -> Basis:
    """A basis whose sums are the weight of the actuator at all samples but the ends; a set for each count of them."""
    sets = []
    for count in counts:
        functions = np.full((actuators, count), 2, np.int16)
        functions[:, [0, -1]] = 0
        sets.append(BasisSet(functions, np.arange(actuators, dtype=np.uint8)))
    return Basis(4000, tuple(sets))


def places_of(device: Device) -> Places:
    return Places.every(device.surface.corner_m, PITCH_M)


def in_zones(device: Device, felt: Sequence[int], quiet: Sequence[int] = ()) -> Placement:
    """A finger in the middle of each of these zones, at the nearest of the places."""
    places = places_of(device)
    names = ([device.zones[zone].name for zone in each] for each in (felt, quiet))
    return places.placement(places.key(Placement.named(device, *names)))


def number_of(device: Device, placement: Placement) -> int:
    key = places_of(device).key(placement)
    number = 0
    for code in key:
        number = (61 * number + code + 1) % _NUMBERS
    return 1 + number


def click_of(device: Device, placement: Placement, *, level_db: float = 26.0, count: int = 121) -> ClickEntry:
    """A click of a device for this placement: so many samples, the greatest is the number of the placement."""
    actuators = len(device.actuators)
    return ClickEntry(
        placement=placement,
        tolerance_m=TOLERANCE_M,
        basis=basis_of(actuators, count),
        basis_set=0,
        weights=np.full(actuators, number_of(device, placement), np.int16),
        fraction_bits=1,
        felt=LevelSpread(level_db + 2, level_db, level_db + 1.5, level_db + 3, level_db - 1),
        quiet=LevelSpread(-3.0, -5.0, -2.5, 0.5, 1.5) if placement.quiet else None,
        fingers=tuple(ClickFinger(1.5, level_db) for _ in placement.position_m),
        exceeds_s={10.0: 0.008, 20.0: 0.005, inf: 0.004},
        peak_s=0.02,
        residual_from_s=0.06,
        residual_db=-3.0,
    )


def made_clicks(device: Device, clicks: Iterable[ClickEntry]) -> Clicks:
    """The clicks of a table, from some that were made by hand."""
    return Clicks.of(places_of(device), list(clicks))


def every_click(device: Device, *, level_db: float = 26.0) -> Clicks:
    """A click for every placement of one and two fingers at different places, of which one at least feels."""
    places = places_of(device)
    codes = range(2 * places.count)
    keys: list[Key] = [(code,) for code in codes if code % 2]
    keys += [(one, other) for one in codes for other in codes if one // 2 < other // 2 and (one % 2 or other % 2)]
    return made_clicks(device, (click_of(device, places.placement(key), level_db=level_db) for key in keys))
