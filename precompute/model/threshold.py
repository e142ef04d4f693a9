"""Detection threshold: the acceleration that a fingertip just detects, by frequency."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Fingertip at about 2 N, peak acceleration in dB re 1e-6 m/s^2: 40 and 250 Hz from Oh and Choi 2019, the rest
# interpolated (docs/theory.md#objective-and-bound). ESTIMATE, within 8 dB between people.
_FREQUENCY_HZ = np.array([40.0, 60.0, 80.0, 100.0, 125.0, 150.0, 175.0, 200.0, 230.0, 250.0, 300.0])
_LEVEL_DB = np.array([113.0, 110.6, 109.0, 107.7, 106.4, 105.3, 104.4, 103.6, 102.8, 102.3, 105.5])
_REFERENCE_M_PER_S2 = 1e-6
THRESHOLD_NAME = "detection threshold of a fingertip after Oh and Choi 2019, ±8 dB between people"
"""Name of the curve, to be shown beside every level; it is an estimate."""


def detection_threshold(frequency_hz: Array) -> Array:
    """Peak acceleration in m/s^2 at each frequency; straight lines in dB over log frequency, the end ones prolonged."""
    octave = np.log2(frequency_hz)
    known = np.log2(_FREQUENCY_HZ)
    piece = np.clip(np.searchsorted(known, octave) - 1, 0, len(known) - 2)
    slope = np.diff(_LEVEL_DB) / np.diff(known)
    level_db = _LEVEL_DB[piece] + slope[piece] * (octave - known[piece])
    threshold: Array = _REFERENCE_M_PER_S2 * 10 ** (level_db / 20)
    return threshold
