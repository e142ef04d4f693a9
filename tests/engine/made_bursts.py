"""Bursts made by hand: the frequency says which state it is for, the figures are all alike."""

from collections.abc import Sequence

from engine.device import Device
from engine.table.burst import BurstEntry, OnsetStep
from engine.table.click import LevelSpread
from engine.touch import ZoneState

SHAPES = (
    (OnsetStep(0.004, 1.0), OnsetStep(0.009, 0.25), OnsetStep(0.012, 1.5)),
    (OnsetStep(0.0, 0.0), OnsetStep(0.005, 2.0), OnsetStep(0.01, 0.0)),
)


def burst_of(
    device: Device,
    states: Sequence[ZoneState],
    *,
    level_db: float = 26.0,
    frequency_hz: float = 150.0,
    shape: int = 0,
    stop_s: float = 0.02,
) -> BurstEntry:
    """A burst of a device for these zone states."""
    count = len(device.actuators)
    return BurstEntry(
        states=tuple(states),
        frequencies_hz=(frequency_hz,) * count,
        amplitudes=(0.4,) * count,
        phases_rad=(0.5,) * count,
        shape=shape,
        stop_s=stop_s,
        felt=LevelSpread(level_db + 2, level_db, level_db + 1.5, level_db + 3),
        quiet=LevelSpread(-3.0, -5.0, -2.5, 0.5) if ZoneState.QUIET in states else None,
    )
