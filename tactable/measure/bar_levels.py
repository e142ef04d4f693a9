"""The steady acceleration and level along the untouched bar that a drive gives by the model. SIMULATED."""

import numpy as np
from numpy.typing import NDArray

from engine.device import Device
from precompute.model.assembly import assemble
from precompute.model.response import by_tone, solve_response
from tactable.measure.asked_drive import AskedDrive

Array = NDArray[np.float64]


def simulate_levels(device: Device, asked: AskedDrive, position_m: Array) -> tuple[Array, Array]:
    """Peaks (point,) in m/s^2 and levels (point,) in dB above the threshold under a held drive, at places in metres.

    Tones of one frequency add as phasors, and the peaks of others as magnitudes (paper eq. (8)). The level is that of
    the summed powers over the threshold at each tone.
    """
    tones_hz, weight = by_tone(np.array(asked.frequencies_hz), asked.phasors)
    unit = solve_response(assemble(device), tones_hz).acceleration(position_m)
    size = abs(np.einsum("fa,fap->fp", weight, unit))
    power = ((size / device.threshold.peak_m_per_s2(tones_hz)[:, None]) ** 2).sum(axis=0)
    return size.sum(axis=0), 10 * np.log10(np.maximum(power, 1e-30))
