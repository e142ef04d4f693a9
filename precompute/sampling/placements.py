"""Random placements: fingers evenly distributed over a surface, at least or exactly a distance apart."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from base.points import is_within, order_of, point_text
from engine.device import Device
from engine.touch import Placement, PlacementError

_MOST_DRAWS = 20_000  # draws of one placement on a plate after which it counts as one that does not fit
_ROUNDING_M = 1e-9


@dataclass(frozen=True)
class Anywhere:
    """Random placements, seeded.

    fingers, of which `feeling` feel, lie at least `apart_m` from one another; where `is_exact`, each lies exactly so
    far from one of the others.
    """

    placements: int = 300
    fingers: int = 2
    feeling: int = 1
    apart_m: float = 25e-3
    is_exact: bool = False
    seed: int = 1


def random_placements(device: Device, wanted: Anywhere) -> list[Placement]:
    """Placements evenly distributed over the surface, its ends and edges included.

    Raises PlacementError where the surface is too small for them, or where no or too many fingers feel.
    """
    if not 1 <= wanted.feeling <= wanted.fingers:
        raise PlacementError(f"{wanted.feeling} of {wanted.fingers} fingers feel: at least one must, and at most all")
    random, found = np.random.default_rng(wanted.seed), list[Placement]()
    draw = _fingers_of_plate if isinstance(device.surface.corner_m, complex) else _fingers_of_bar
    for _ in range(wanted.placements):
        at_m = draw(random, device.surface.corner_m, wanted)
        if at_m is None:
            raise PlacementError(
                f"{wanted.fingers} fingers {1e3 * wanted.apart_m:g} mm apart do not fit on "
                f"{point_text(device.surface.corner_m)}"
            )
        felt = set(random.permutation(wanted.fingers)[: wanted.feeling].tolist())
        found.append(
            Placement.on(
                device,
                [each_m for finger, each_m in enumerate(at_m) if finger in felt],
                [each_m for finger, each_m in enumerate(at_m) if finger not in felt],
            )
        )
    return found


def _fingers_of_bar(random: np.random.Generator, corner_m: complex, wanted: Anywhere) -> list[complex] | None:
    """Even over all ordered positions that keep the distance: spread without it, then moved apart."""
    gaps_m = wanted.apart_m * np.arange(wanted.fingers)
    span_m = corner_m.real - gaps_m[-1]
    if span_m < 0:
        return None
    free_m = np.sort(random.uniform(0, span_m, 1 if wanted.is_exact else wanted.fingers))
    return (free_m + gaps_m).tolist()


def _fingers_of_plate(random: np.random.Generator, corner_m: complex, wanted: Anywhere) -> list[complex] | None:
    """Even over the plate, drawn until all keep the distance; where it is exact, each lies around the one before."""
    for _ in range(_MOST_DRAWS):
        x, y = random.random((2, wanted.fingers))
        at_m = (corner_m.real * x + 1j * corner_m.imag * y).tolist()
        if wanted.is_exact:
            ways = wanted.apart_m * np.exp(2j * np.pi * x)
            at_m = (at_m[0] + np.concatenate([[0], np.cumsum(ways[1:])])).tolist()
        near = any(abs(one - other) < wanted.apart_m - _ROUNDING_M for one, other in combinations(at_m, 2))
        if not near and all(is_within(each_m, corner_m) for each_m in at_m):
            return sorted(at_m, key=order_of)
    return None
