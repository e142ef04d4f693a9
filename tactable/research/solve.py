"""Clicks and steady drives for fingers on a device, solved now and without a table."""

from collections.abc import Sequence
from functools import lru_cache
from math import inf
from typing import TYPE_CHECKING

from engine.device import Device
from engine.table.click_entry import played_at
from engine.table.levels import DEFAULT_LEVEL_DB
from engine.touch import Placement
from engine.touch.placement import PlacementError
from tactable.research.played import Click, Drive, asked_placement

if TYPE_CHECKING:
    from precompute.clicks import ClickSolver
    from precompute.predict.at_positions import SteadyDesigner


def solve_click(
    device: Device, felt: Sequence[str | complex], quiet: Sequence[str | complex] = (), level_db: float = inf
) -> Click:
    """Solve the click for up to ten fingers where they are; infinite `level_db`: as strong as it can be.

    A position is a text such as "35 mm", metres, or the name of a zone, which means its middle. The first click of a
    device also samples its plants, which takes a fraction of a second. Raises PlacementError for positions that are no
    placement, and where no finger is felt.

    >>> click = solve_click(device, felt=["35 mm"], quiet=["120 mm", "200 mm"])
    >>> click.waveform.shape
    (121, 2)
    """
    placement = _felt_placement(device, felt, quiet, level_db)
    return Click.of(played_at(_click_solver(device).solve_entry(placement), level_db), device, placement)


def solve_drive(
    device: Device,
    felt: Sequence[str | complex],
    quiet: Sequence[str | complex] = (),
    level_db: float = DEFAULT_LEVEL_DB,
) -> Drive:
    """Solve the steady drive for fingers where they are, given as in `solve_click`, at a level in dB.

    >>> solve_drive(device, felt=["35 mm"], quiet=["120 mm"], level_db=20).achieved
    True
    """
    placement = _felt_placement(device, felt, quiet, level_db)
    found = _designer(device).solver.solve(placement.position_m, placement.is_felt, level_db)
    return Drive.of(found, device, placement)


def _felt_placement(
    device: Device, felt: Sequence[str | complex], quiet: Sequence[str | complex], level_db: float
) -> Placement:
    placement = asked_placement(device, felt, quiet, level_db)
    if not felt:
        raise PlacementError('no finger is felt: name at least one, such as felt=["35 mm"]')
    return placement


@lru_cache(maxsize=4)
def _click_solver(device: Device) -> "ClickSolver":
    from precompute.clicks import DEFAULT_OPTIONS, ClickSolver

    return ClickSolver(device, DEFAULT_OPTIONS.at_fingers)


@lru_cache(maxsize=4)
def _designer(device: Device) -> "SteadyDesigner":
    from precompute.predict.at_positions import SteadyDesigner

    return SteadyDesigner(device)
