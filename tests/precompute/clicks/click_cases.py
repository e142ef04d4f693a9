"""Placements and cheap options with which the laws of clicks are checked."""

from engine.device import Device
from engine.touch import Placement, ZoneState
from precompute.clicks.options import ClickOptions

CHEAP = ClickOptions(lengths_s=(0.02,), quiet_db=0.0, crowding=1.0, scenarios=6, trimmed=20, judged=20)
"""Few plants: enough for laws, not for figures."""

_KINDS = {"-": ZoneState.FREE, "q": ZoneState.QUIET, "F": ZoneState.FELT}


def states(letters: str) -> tuple[ZoneState, ...]:
    """One letter a zone: F felt, q quiet, - free."""
    return tuple(_KINDS[letter] for letter in letters)


def placed(device: Device, letters: str) -> Placement:
    """Fingers in the middles of the zones."""
    return Placement.in_zones(device, states(letters))
