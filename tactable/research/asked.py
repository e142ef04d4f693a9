"""Checks the fingers and the level that a program asks for, and makes a placement of them."""

from collections.abc import Sequence
from math import isnan
from numbers import Complex, Real

from engine.device import Device
from engine.touch import Placement
from engine.touch.placement import PlacementError


def asked_placement(
    device: Device, felt: Sequence[str | complex], quiet: Sequence[str | complex], level_db: float
) -> Placement:
    """The placement of these fingers. Raises PlacementError if they are no list of positions or the level no number."""
    for role, fingers in (("felt", felt), ("quiet", quiet)):
        if isinstance(fingers, Complex):
            raise PlacementError(f"{role}={fingers!r}: is one position; give a list, such as [{fingers!r}]")
        for each in fingers:
            if not isinstance(each, str | Complex):
                raise PlacementError(f"{role}: {each!r}: expected a text such as '35 mm', metres or the name of a zone")
    if not isinstance(level_db, Real) or isnan(level_db):
        raise PlacementError(f"level_db={level_db!r}: expected a number of dB above the threshold, such as 20")
    return Placement.named(device, felt, quiet)
