"""Sampled fingers for tests, and the default threshold curve apart from the device's."""

import numpy as np

from engine.device import Device, Finger
from engine.steady.cases import FingerCases
from precompute.predict.at_positions import SAMPLES
from precompute.sampling.plants import Fingers

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


def sample_cases(device: Device, zones: tuple[int, ...]) -> FingerCases:
    """A finger anywhere in each of these zones, its parameters within the spread; the standard case first."""
    random, finger, shape = np.random.default_rng(20230247606), device.finger, (SAMPLES + 1, len(zones))
    part, factor = random.uniform(0.05, 0.95, shape), finger.spread ** random.uniform(-1, 1, (*shape, 3))
    part[0], factor[0] = 0.5, 1.0
    start_m, stop_m = np.array([(device.zones[zone].start_m, device.zones[zone].stop_m) for zone in zones]).T
    standard = np.array([finger.stiffness_n_per_m, finger.damping_n_s_per_m, finger.mass_kg])
    return FingerCases(start_m + part * (stop_m - start_m), standard * factor)


def fingers_of(cases: FingerCases, case: int) -> list[tuple[complex, Finger]]:
    """Point and finger of every finger of one case."""
    return Fingers(cases.position_m, *np.moveaxis(cases.impedance, 2, 0)).of(case)
