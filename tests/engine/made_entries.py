"""Entries made by hand: the drive says which state it is for, the figures are all alike."""

from collections.abc import Sequence
from itertools import product
from math import inf

from engine.device import Device
from engine.table import Entry
from engine.table.entry import DEFAULT_LEVEL_DB, WorstCase, ZonePrediction
from engine.touch import ZoneState

LEVEL_DB = DEFAULT_LEVEL_DB


def entry_of(
    device: Device,
    states: Sequence[ZoneState],
    *,
    frequencies_hz: tuple[float, ...] = (100.0, 61.25),
    amplitudes: tuple[float, ...] = (1.0, 0.25),
    phases_rad: tuple[float, ...] = (0.0, 1.5),
    wanted_level_db: float = LEVEL_DB,
    achieved: bool = True,
) -> Entry:
    """An entry of a device for these zone states."""
    return Entry(
        frequencies_hz=frequencies_hz,
        amplitudes=amplitudes,
        phases_rad=phases_rad,
        zones=tuple(
            zone_promise(zone.name, state, wanted_level_db) for zone, state in zip(device.zones, states, strict=True)
        ),
        wanted_level_db=wanted_level_db,
        level_db=40.0 if wanted_level_db == inf else wanted_level_db,
        achieved=achieved,
        contrast_db=12.0,
        expected_contrast_db=11.0,
        localized_factor=0.5,
        objective="contrast",
        upper_bound=12.0,
        optimality_gap_db=1.0,
        t90_s=0.1,
        family="coherent",
        limited_by="",
        worst_case=WorstCase(wanted_level_db - 2, 9.0, 8.0, 0.3, 0.2),
    )


def zone_promise(name: str, state: ZoneState, level_db: float) -> ZonePrediction:
    """What a zone does: a touched one has a finger."""
    is_touched = state is not ZoneState.FREE
    return ZonePrediction(
        name=name,
        state=state,
        share=0.2,
        share_range=(0.1, 0.3),
        peak_acceleration_m_per_s2=1.0,
        peak_acceleration_range_m_per_s2=(0.5, 2.0),
        peak_position_m=0.01,
        dead_acceleration_m_per_s2=0.1,
        dead_position_m=0.02,
        acceleration_at_finger_m_per_s2=0.8 if is_touched else None,
        sensation_level_db=level_db if is_touched else None,
        sensation_level_range_db=(level_db - 2, level_db + 2) if is_touched else None,
    )


def states_of(device: Device, felt: Sequence[int], quiet: Sequence[int] = ()) -> tuple[ZoneState, ...]:
    """State of every zone, from the indices of those that are not free."""
    return tuple(
        ZoneState.FELT if zone in felt else ZoneState.QUIET if zone in quiet else ZoneState.FREE
        for zone in range(len(device.zones))
    )


def felt_states(device: Device) -> list[tuple[ZoneState, ...]]:
    """Every state with a felt zone: those that a table has entries for."""
    states = product(ZoneState, repeat=len(device.zones))
    return [state for state in states if ZoneState.FELT in state]
