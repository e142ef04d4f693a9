"""States of the zones by the indices of those that are touched, and the level that tests play at."""

from collections.abc import Sequence

from engine.device import Device
from engine.table.levels import DEFAULT_LEVEL_DB
from engine.touch import ZoneState

LEVEL_DB = DEFAULT_LEVEL_DB


def states_of(device: Device, felt: Sequence[int], quiet: Sequence[int] = ()) -> tuple[ZoneState, ...]:
    """State of every zone, from the indices of those that are not free."""
    return tuple(
        ZoneState.FELT if zone in felt else ZoneState.QUIET if zone in quiet else ZoneState.FREE
        for zone in range(len(device.zones))
    )


def state_index(states: Sequence[ZoneState]) -> int:
    """The states of all zones as one number: the sum of state times 3**zone, 0 when all are free."""
    return sum(int(state) * 3**zone for zone, state in enumerate(states))
