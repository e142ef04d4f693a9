"""Sampled surfaces: those that a calibration cannot tell apart, each with one case of the sampled fingers."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from base.arrays import Array, Complex
from engine.device import Device
from engine.steady.cases import SEED
from precompute.model.assembly import free_surface
from precompute.model.plant import Plant
from precompute.model.response import by_tone, solve_response
from precompute.sampling.fingers import SampledFingers
from precompute.sampling.plants import sample_scenarios


@dataclass(frozen=True)
class SampledSurfaces:
    """One plant for each sampled case of `sampled`; its first case, the standard one, has none."""

    plants: tuple[Plant, ...]
    sampled: SampledFingers

    def powers(self, touched: Sequence[int], frequency_hz: Array, amplitude: Complex) -> Array:
        """Power over threshold under each finger (plant, finger), fingers in the zones `touched` (indices).

        frequency_hz, amplitude (actuator,): the drive, as fractions of full scale; powers of different tones add.
        """
        tones, weight = by_tone(frequency_hz, amplitude)
        threshold = self.plants[0].device.threshold.peak_m_per_s2(tones)[:, None]
        powers = np.empty((len(self.plants), len(touched)))
        for case, plant in enumerate(self.plants, 1):
            places_m, fingers = zip(*self.sampled.fingers(case, touched), strict=True)
            unit = solve_response(plant.with_fingers(places_m, fingers), tones).acceleration(np.array(places_m))
            powers[case - 1] = (abs(np.einsum("ta,tap->tp", weight, unit) / threshold) ** 2).sum(axis=0)
        return powers


def sample_surfaces(device: Device, sampled: SampledFingers) -> SampledSurfaces | None:
    """One plant for each sampled case; None where no calibration says how well the device is known.

    What was fitted varies as the calibration has left it, the rest of surface and actuators within the device's spread.
    """
    if device.uncertainty is None:
        return None
    scenarios, free = sample_scenarios(device, len(sampled.place) - 1, SEED), free_surface(device)
    plants = tuple(free.plant(scenarios.device_of(i)) for i in range(1, len(sampled.place)))
    return SampledSurfaces(plants, sampled)
