"""Sampled fingers for tests, and the default threshold curve apart from the device's."""

import numpy as np

from engine.device import Device
from precompute.sampling.fingers import SAMPLES, SampledFingers

PLACES = 7
"""Places in a zone where a finger may lie."""
THRESHOLD_DB = {
    40: 113.0, 60: 110.6, 80: 109.0, 100: 107.7, 125: 106.4, 150: 105.3,
    175: 104.4, 200: 103.6, 230: 102.8, 250: 102.3, 300: 105.5,
}  # fmt: skip
"""docs/theory.md#objective-and-bound: peak acceleration in dB re 1e-6 m/s^2 by frequency in Hz."""


def threshold(frequency_hz: float) -> float:
    """Peak acceleration in m/s^2, from 40 to 300 Hz."""
    assert 40 <= frequency_hz <= 300
    level_db = np.interp(np.log(frequency_hz), np.log(list(THRESHOLD_DB)), list(THRESHOLD_DB.values()))
    return float(1e-6 * 10 ** (level_db / 20))


def sample_fingers(device: Device) -> SampledFingers:
    """A finger anywhere in each zone, its parameters within the spread of the device; the standard case first."""
    random, count, finger = np.random.default_rng(20230247606), len(device.zones), device.finger
    factor = finger.spread ** random.uniform(-1, 1, (3, SAMPLES + 1, count))
    place = random.integers(PLACES, size=(SAMPLES + 1, count))
    factor[:, 0], place[0] = 1.0, PLACES // 2
    parts = np.linspace(0.0, 1.0, 2 * PLACES + 1)[1::2]
    return SampledFingers(
        position_m=np.array([zone.start_m + parts * zone.length_m for zone in device.zones]),
        place=place,
        mass_kg=finger.mass_kg * factor[0],
        damping_n_s_per_m=finger.damping_n_s_per_m * factor[1],
        stiffness_n_per_m=finger.stiffness_n_per_m * factor[2],
    )
