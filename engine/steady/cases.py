"""Sampled cases of the fingers of a placement: their stiffness, damping, mass, and exact position."""

from dataclasses import dataclass

import numpy as np

from base.arrays import Array, Points
from base.points import clip_points
from engine.device import Finger

TOLERANCE_M = 1e-3  # how far a finger may lie from where the digitizer says, evenly distributed to both sides
SEED = 20230247606  # fixed: tables repeat bit for bit; other cases move expected contrasts by up to 4 dB (reference-a)
_TRIES = 64  # mean correlation of three fingers: 0.148 of 8 tries, 0.139 of 64, 0.132 of 512 (50 ms)


@dataclass(frozen=True)
class FingerCases:
    """The standard case first, then sampled ones: position_m (case, finger), impedance (case, finger, 3).

    impedance: stiffness in N/m, damping in N s/m, mass in kg.
    """

    position_m: Points
    impedance: Array


@dataclass(frozen=True)
class Deviations:
    """Deviations of fingers in sampled cases, the standard case first, by rank of the fingers along the bar.

    offset (case, finger): within -1 and 1 of the position's tolerance; exponent (case, finger, 3): within -1 and 1,
    of the spread's factor on stiffness, damping and mass.
    """

    offset: Points
    exponent: Array


def sample_deviations(fingers: int, cases: int, axes: int = 1) -> Deviations:
    """A seeded Latin hypercube of `cases` (even) cases, the least correlated of some.

    Half of the cases are the mirror images of the others, so that a mirrored placement on a mirrored bar gets a
    mirrored drive. axes: along which the place varies, two on a plate.
    """
    random, half, width = np.random.default_rng(SEED), cases // 2, axes + 3
    best, least = np.zeros((half, width * fingers)), np.inf
    for _ in range(_TRIES):
        rank = np.stack([random.permutation(half) for _ in range(width * fingers)], axis=1)
        points = (2 * rank + 1) / half - 1
        product = points.T @ points / half
        worst = abs(product - np.diag(np.diag(product))).sum()
        if worst < least:
            best, least = points, worst
    points = best.reshape(half, fingers, width)
    image = points[:, ::-1].copy()
    image[:, :, 0] *= -1
    every = np.concatenate([np.zeros((1, fingers, width)), points, image])
    offset = every[:, :, 0] if axes == 1 else every[:, :, 0] + 1j * every[:, :, 1]
    return Deviations(offset=offset, exponent=every[:, :, axes:])


def axes_of(corner_m: complex) -> int:
    """Axes along which places vary on the surface that reaches from 0 to `corner_m`."""
    return 1 + isinstance(corner_m, complex)


def cases_at(position_m: Points, deviations: Deviations, finger: Finger, corner_m: complex) -> FingerCases:
    """The cases of fingers at points (finger,), kept on the surface that reaches from 0 to `corner_m`."""
    rank = np.argsort(np.argsort(position_m, kind="stable"), kind="stable")
    standard = np.array([finger.stiffness_n_per_m, finger.damping_n_s_per_m, finger.mass_kg])
    return FingerCases(
        position_m=np.ascontiguousarray(clip_points(position_m + TOLERANCE_M * deviations.offset[:, rank], corner_m)),
        impedance=standard * finger.spread ** deviations.exponent[:, rank],
    )
