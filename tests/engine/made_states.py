"""States of the zones by the indices of those that are touched, the level that tests play at, and rows for both."""

from collections.abc import Sequence
from itertools import chain, combinations

from engine.device import Device
from engine.table.best_rows import BestRow, BestRows
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


def row_of(device: Device, zones: Sequence[int], level_db: float = LEVEL_DB, *, achieved: bool = True) -> BestRow:
    """A row of two frequencies: 100 Hz and more for more zones, and 2 Hz more for each dB."""
    hz = 100.0 + sum(1 << zone for zone in zones)
    each = tuple(1.0 + zone for zone in range(len(device.zones)))
    return BestRow(
        zones=tuple(zones),
        wanted_level_db=level_db,
        group="sweep",
        index=0,
        frequencies_hz=(hz, 150.0 + 2 * min(level_db, 60.0)),
        amplitudes=(0.5, 0.25),
        phases_rad=(0.0, 0.0),
        level_db=min(level_db, 40.0) if achieved else level_db - 5,
        achieved=achieved,
        localized_factor=0.5,
        limited_by="",
        shares=each,
        peaks_m_per_s2=each,
        dead_spots_m_per_s2=each,
    )


def rows_of(device: Device, levels_db: Sequence[float] = (LEVEL_DB,), short_of: Sequence[int] = ()) -> BestRows:
    """A row for every combination at every level; those with a zone in `short_of` do not reach it."""
    zones = range(len(device.zones))
    every = list(chain.from_iterable(combinations(zones, count + 1) for count in zones))
    rows = [
        row_of(device, each, level_db, achieved=not set(each) & set(short_of))
        for level_db in levels_db
        for each in every
    ]
    return BestRows(rows, device.limits.amplitude)
