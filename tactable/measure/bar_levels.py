"""The steady acceleration and level along the untouched bar that a drive gives by the model. SIMULATED."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.device import Device
from precompute.model.assembly import assemble
from precompute.model.response import by_tone, solve_response
from tactable.measure.asked_drive import AskedDrive

Array = NDArray[np.float64]

POINTS = 11  # each tenth of the bar: a row of text each


@dataclass(frozen=True)
class BarLevels:
    """Peaks (point,) in m/s^2 of all tones together, and levels (point,) in dB above the detection threshold."""

    position_m: Array
    peak_m_per_s2: Array
    level_db: Array


def simulate_levels(device: Device, asked: AskedDrive, position_m: Array | None = None) -> BarLevels:
    """The bar under a held drive; tones of one frequency add as phasors, others as magnitudes (paper eq. (8)).

    The level is that of the summed powers over the threshold at each tone.
    """
    places_m = np.linspace(0.0, device.bar.length_m, POINTS) if position_m is None else position_m
    tones_hz, weight = by_tone(np.array(asked.frequencies_hz), asked.phasors)
    unit = solve_response(assemble(device), tones_hz).acceleration(places_m)
    size = abs(np.einsum("fa,fap->fp", weight, unit))
    power = ((size / device.threshold.peak_m_per_s2(tones_hz)[:, None]) ** 2).sum(axis=0)
    return BarLevels(places_m, size.sum(axis=0), 10 * np.log10(np.maximum(power, 1e-30)))
