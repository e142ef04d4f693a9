"""Clicks made by hand: the waveform says which state it is for, the figures are all alike."""

from collections.abc import Sequence
from functools import cache
from math import inf

import numpy as np

from engine.device import Device
from engine.table import ClickEntry
from engine.table.click import ClickZone, LevelSpread
from engine.touch import ZoneState, state_index
from firmware_link.protocol.basis import Basis, BasisSet


@cache
def basis_of(actuators: int, *counts: int) -> Basis:
    """A basis whose sums are the weight of the actuator at all samples but the ends; a set for each count of them."""
    sets = []
    for count in counts:
        functions = np.full((actuators, count), 2, np.int16)
        functions[:, [0, -1]] = 0
        sets.append(BasisSet(functions, np.arange(actuators, dtype=np.uint8)))
    return Basis(4000, tuple(sets))


def click_of(
    device: Device, states: Sequence[ZoneState], *, level_db: float = 26.0, count: int = 121, achieved: bool = True
) -> ClickEntry:
    """A click of a device for these zone states: so many samples, the greatest is the number of the state."""
    actuators = len(device.actuators)
    is_quiet = ZoneState.QUIET in states
    return ClickEntry(
        states=tuple(states),
        basis=basis_of(actuators, count),
        basis_set=0,
        weights=np.full(actuators, state_index(states), np.int16),
        fraction_bits=1,
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
