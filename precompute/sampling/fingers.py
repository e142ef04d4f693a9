"""Sampled fingers: in each case one finger for every place that is touched."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from base.arrays import Array, Complex, Integers
from engine.device import Finger

SAMPLES = 32  # sampled cases, each with its own finger in every zone


@dataclass(frozen=True)
class SampledFingers:
    """The standard case first, then sampled ones. A case has one finger for every zone; a state uses some of them.

    position_m (zone, place); place (case, zone) tells which of these; mass, damping, stiffness (case, zone).
    """

    position_m: Array
    place: Integers
    mass_kg: Array
    damping_n_s_per_m: Array
    stiffness_n_per_m: Array

    def fingers(self, case: int, zones: Sequence[int]) -> list[tuple[complex, Finger]]:
        """Point and finger of one case, in each of `zones` (indices)."""
        return [
            (
                self.position_m[zone, self.place[case, zone]].item(),
                Finger(
                    mass_kg=float(self.mass_kg[case, zone]),
                    damping_n_s_per_m=float(self.damping_n_s_per_m[case, zone]),
                    stiffness_n_per_m=float(self.stiffness_n_per_m[case, zone]),
                    spread=1.0,
                ),
            )
            for zone in zones
        ]

    def dynamic_stiffness(self, frequency_hz: Array) -> Complex:
        """Shape (frequency, case, zone), N/m: k + j omega c - omega^2 m of every finger."""
        omega = 2 * np.pi * frequency_hz[:, None, None]
        real: Array = self.stiffness_n_per_m - omega**2 * self.mass_kg
        return real + 1j * (omega * self.damping_n_s_per_m)
