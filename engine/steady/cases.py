"""Sampled cases of the fingers of a placement, and of the surface and the channels where a set of spreads has these."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from base.arrays import Array, Complex, Integers, Points
from base.points import clip_points
from engine.device import Device

SEED = 20230247606  # fixed: tables repeat bit for bit; other cases move expected contrasts by up to 4 dB (reference-a)
_TRIES = 64  # mean correlation of three fingers: 0.148 of 8 tries, 0.139 of 64, 0.132 of 512 (50 ms)
_WITHIN_95 = 1.96  # standard errors


class MeasuredFinger(NamedTuple):
    """A finger that was measured where it lies: logarithm of its impedance over the standard one's, standard error."""

    position_m: complex
    load: float
    error: float


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


def cases_at(
    position_m: Points, deviations: Deviations, device: Device, measured: Sequence[MeasuredFinger | None] = ()
) -> FingerCases:
    """The cases of fingers at points (finger,), kept on the surface; measured: what is known of each, if of any.

    The standard case has a measured finger as it was measured, the others vary it within 95 % of its error.
    """
    finger, offset_m = device.finger, device.spread.reach_m * deviations.offset
    rank = np.argsort(np.argsort(position_m, kind="stable"), kind="stable")
    standard = np.array([finger.stiffness_n_per_m, finger.damping_n_s_per_m, finger.mass_kg])
    width = np.full((len(position_m), 1), math.log(finger.spread))
    load = np.zeros((len(position_m), 1))
    for number, known in enumerate(measured):
        if known is not None:
            load[number], width[number] = known.load, min(width[number, 0], _WITHIN_95 * known.error)
    return FingerCases(
        position_m=np.ascontiguousarray(clip_points(position_m + offset_m[:, rank], device.surface.corner_m)),
        impedance=standard * np.exp(load + width * deviations.exponent[:, rank]),
    )


@dataclass(frozen=True)
class PlantErrors:
    """What differs in sampled cases beside the fingers; in the standard case, the first, nothing does.

    stretch (case,): factor on all natural frequencies, which stands for stiffness, mass and length as a whole. gain
    (case, actuator), delay_s (case, actuator): of the channels.
    """

    stretch: Array
    gain: Array
    delay_s: Array

    @classmethod
    def sample(cls, device: Device, cases: int) -> "PlantErrors | None":
        """Seeded errors of `cases` cases (odd) within the device's spread.

        Half of the cases have the opposite errors. The natural frequencies of a calibrated surface are taken as known.
        The result is None for a spread of fingers alone, such as "bench".
        """
        spread, half, actuators = device.spread, (cases - 1) // 2, len(device.actuators)
        if not spread.is_of_bars:
            return None
        random, step = (
            np.random.default_rng(SEED),
            np.array([NormalDist().inv_cdf((k + 0.5) / half) for k in range(half)]),
        )
        normal, gain, even = (
            np.stack([random.permutation(each) for _ in range(count)], axis=1)
            for each, count in ((step, 1), (step, actuators), ((2 * np.arange(half) + 1) / half - 1, actuators))
        )
        size = 0.0 if device.uncertainty is not None else spread.stretch
        stretch, gains, delay = (
            np.concatenate([np.zeros((1, each.shape[1])), each, -each]) for each in (size * normal, gain, even)
        )
        return cls(1 + stretch[:, 0], 1 + spread.gain * gains, spread.delay_s * delay)

    def channels(self, frequency_hz: Array) -> Complex:
        """Factor (case, actuator, frequency) from a command to what its channel plays."""
        turn = 2j * np.pi * frequency_hz * self.delay_s[..., None]
        return np.asarray(self.gain[..., None] * np.exp(-turn), dtype=np.complex128)

    def lines(self, frequency_hz: Array) -> tuple[Integers, Array]:
        """Where on a rising grid each case has what the nominal surface has at its lines (case, frequency).

        The line below, and the weight of the one above it.
        """
        at_hz = frequency_hz / self.stretch[:, None]
        below = np.clip(np.searchsorted(frequency_hz, at_hz, side="right") - 1, 0, len(frequency_hz) - 2)
        step_hz = frequency_hz[below + 1] - frequency_hz[below]
        return below, np.clip((at_hz - frequency_hz[below]) / step_hz, 0.0, 1.0)
