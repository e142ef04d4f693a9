"""Receptances of the untouched bar at even places along it, by frequency: what steady drives are solved from.

Optima are sharp and responses are smooth (docs/theory.md#steady-drives-at-positions), so the receptances are what is
stored and interpolated, never a drive.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex32 = NDArray[np.complex64]


@dataclass(frozen=True)
class Receptances:
    """Displacements of the untouched bar at places (place,) that are one pitch apart, from its start to its end.

    frequency_hz, threshold_m_per_s2 (frequency,): rising, and the detection threshold there. drive (place, actuator,
    frequency): metres at full scale. point (pair, frequency): metres per newton between two places; it is symmetric, so
    the pairs are those of `np.triu_indices`, row by row.
    """

    frequency_hz: Array
    threshold_m_per_s2: Array
    place_m: Array
    drive: Complex32
    point: Complex32

    @property
    def pitch_m(self) -> float:
        """Distance of neighbouring places."""
        return float(self.place_m[1] - self.place_m[0])
