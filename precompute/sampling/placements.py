"""Random placements: fingers evenly distributed over the bar, at least or exactly a distance apart."""

from dataclasses import dataclass

import numpy as np

from engine.device import Device
from engine.touch import Placement, PlacementError


@dataclass(frozen=True)
class Anywhere:
    """Random placements, seeded.

    fingers, of which `feeling` feel, lie at least `apart_m` from one another, or exactly so where `is_exact`.
    """

    placements: int = 300
    fingers: int = 2
    feeling: int = 1
    apart_m: float = 25e-3
    is_exact: bool = False
    seed: int = 1


def random_placements(device: Device, wanted: Anywhere) -> list[Placement]:
    """Placements evenly distributed over the bar, its ends included.

    Raises PlacementError where the bar is too short for them, or where no or too many fingers feel.
    """
    if not 1 <= wanted.feeling <= wanted.fingers:
        raise PlacementError(f"{wanted.feeling} of {wanted.fingers} fingers feel: at least one must, and at most all")
    span_m = device.bar.length_m - wanted.apart_m * (wanted.fingers - 1)
    if span_m < 0:
        raise PlacementError(
            f"{wanted.fingers} fingers {1e3 * wanted.apart_m:g} mm apart do not fit on {1e3 * device.bar.length_m:g} mm"
        )
    random, found = np.random.default_rng(wanted.seed), list[Placement]()
    for _ in range(wanted.placements):
        # Even over all ordered positions that keep the distance: spread without it, then moved apart.
        gaps_m = wanted.apart_m * np.arange(wanted.fingers)
        free_m = np.sort(random.uniform(0, span_m, 1 if wanted.is_exact else wanted.fingers))
        at_m = (free_m + gaps_m).tolist()
        felt = set(random.permutation(wanted.fingers)[: wanted.feeling].tolist())
        found.append(
            Placement.on(
                device,
                [each_m for finger, each_m in enumerate(at_m) if finger in felt],
                [each_m for finger, each_m in enumerate(at_m) if finger not in felt],
            )
        )
    return found
