"""Clicks made by hand: the waveform says which state it is for, the figures are all alike."""

from collections.abc import Sequence
from math import inf

import numpy as np

from engine.device import Device
from engine.table import ClickEntry
from engine.table.click import ClickZone, LevelSpread
from engine.touch import ZoneState, state_index


def click_of(
    device: Device, states: Sequence[ZoneState], *, level_db: float = 26.0, count: int = 121, achieved: bool = True
) -> ClickEntry:
    """A click of a device for these zone states: so many samples, the greatest is the number of the state."""
    samples = np.zeros((count, len(device.actuators)), dtype=np.int16)
    samples[1:-1] = state_index(states)
    is_quiet = ZoneState.QUIET in states
    return ClickEntry(
        states=tuple(states),
        sample_rate_hz=4000,
        samples=samples,
        amplitude=1.0,
        wanted_level_db=inf,
        achieved=achieved,
        felt=LevelSpread(level_db + 2, level_db, level_db + 1.5, level_db + 3),
        quiet=LevelSpread(-3.0, -5.0, -2.5, 0.5) if is_quiet else None,
        zones=tuple(None if state is ZoneState.FREE else ClickZone(1.5, level_db) for state in states),
        exceeds_s={10.0: 0.008, 20.0: 0.005, inf: 0.004},
        peak_s=0.02,
        residual_from_s=0.06,
        residual_db=-3.0,
        objective="peak",
        bound_db=level_db + 3,
        gap_db=1.0,
    )
