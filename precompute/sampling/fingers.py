"""Sampled fingers: the places in each zone where a finger may lie, and the fingers that may lie there."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from engine.device import Device, Finger

Array = NDArray[np.float64]

PLACES = 7
"""Places in a zone where a finger may lie: the middles of as many equal parts."""
SAMPLES = 32
"""Sampled cases, each with its own finger in every zone."""
_SEED = 20230247606


@dataclass(frozen=True)
class SampledFingers:
    """The standard case first, then sampled ones. A case has one finger for every zone; a state uses some of them.

    position_m (zone, place); place (case, zone) tells which of these; mass, damping, stiffness (case, zone).
    """

    position_m: Array
    place: NDArray[np.int64]
    mass_kg: Array
    damping_n_s_per_m: Array
    stiffness_n_per_m: Array

    @property
    def middle_m(self) -> Array:
        """Shape (zone,): where the standard finger lies."""
        return self.position_m[:, PLACES // 2]

    def fingers(self, case: int, zones: Sequence[int]) -> list[tuple[float, Finger]]:
        """Position in metres and finger of one case, in each of `zones` (indices)."""
        return [
            (
                float(self.position_m[zone, self.place[case, zone]]),
                Finger(
                    mass_kg=float(self.mass_kg[case, zone]),
                    damping_n_s_per_m=float(self.damping_n_s_per_m[case, zone]),
                    stiffness_n_per_m=float(self.stiffness_n_per_m[case, zone]),
                    spread=1.0,
                ),
            )
            for zone in zones
        ]

    def dynamic_stiffness(self, frequency_hz: Array) -> NDArray[np.complex128]:
        """Shape (frequency, case, zone), N/m: k + j omega c - omega^2 m of every finger."""
        omega = 2 * np.pi * frequency_hz[:, None, None]
        real: Array = self.stiffness_n_per_m - omega**2 * self.mass_kg
        return real + 1j * (omega * self.damping_n_s_per_m)


def sample_fingers(device: Device, samples: int = SAMPLES) -> SampledFingers:
    """Places evenly over the zone, parameters log-evenly within `finger.spread` (a seeded Latin hypercube).

    Half of the samples are the mirror images of the others, so that a mirrored bar gets a mirrored table.
    """
    count, finger = len(device.zones), device.finger
    points = _hypercube(samples // 2, 4 * count).reshape(samples // 2, 4, count)
    image = points[:, :, ::-1].copy()
    image[:, 0] = 1 - image[:, 0]
    points = np.concatenate([points, image])
    factor = finger.spread ** (2 * points[:, 1:] - 1)
    place = np.minimum((points[:, 0] * PLACES).astype(np.int64), PLACES - 1)
    middle = np.full((1, count), PLACES // 2, dtype=np.int64)
    one = np.ones((1, count))
    parts = np.linspace(0.0, 1.0, 2 * PLACES + 1)[1::2]
    return SampledFingers(
        position_m=np.array([zone.start_m + parts * zone.length_m for zone in device.zones]),
        place=np.concatenate([middle, place]),
        mass_kg=finger.mass_kg * np.concatenate([one, factor[:, 0]]),
        damping_n_s_per_m=finger.damping_n_s_per_m * np.concatenate([one, factor[:, 1]]),
        stiffness_n_per_m=finger.stiffness_n_per_m * np.concatenate([one, factor[:, 2]]),
    )


@cache
def _hypercube(points: int, dimensions: int) -> Array:
    """Shape (point, dimension), in [0, 1), read-only: the same for every bar with as many zones, and dear to find."""
    hypercube: Array = qmc.LatinHypercube(dimensions, optimization="random-cd", seed=_SEED).random(points)
    hypercube.flags.writeable = False
    return hypercube
