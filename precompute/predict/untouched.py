"""Drives with the greatest share of energy in some zones of the untouched bar, paper eq. (11)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from base.arrays import Array, Complex, Mask
from precompute.model.frequencies import fine_frequencies, in_band
from precompute.model.gram import compute_gram
from precompute.model.plant import Plant
from precompute.model.response import solve_response


@dataclass(frozen=True)
class BarDrive:
    """One tone an actuator, frequency_hz and amplitude (actuator,), complex, at full scale; `name` says whose it is."""

    name: str
    frequency_hz: Array
    amplitude: Complex


@dataclass(frozen=True)
class UntouchedEnergy:
    """Energies of the untouched bar, from which its optima for any zones follow.

    frequency_hz (frequency,); by_zone (frequency, zone, actuator, actuator) and total (frequency, actuator, actuator),
    the Gram matrices of docs/theory.md#tabulated-quantities; usable (frequency, actuator): which actuators may play it.
    """

    frequency_hz: Array
    by_zone: Complex
    total: Complex
    usable: Mask

    @classmethod
    def of_plant(cls, plant: Plant) -> "UntouchedEnergy":
        """The energy by finite elements, over `fine_frequencies`."""
        frequency_hz = fine_frequencies(plant)
        by_zone, total = compute_gram(solve_response(plant, frequency_hz))
        return cls(frequency_hz, by_zone, total, in_band(plant.device, frequency_hz))

    def best_alone(self, zones: Sequence[int]) -> BarDrive:
        """The best drive of tones of different frequencies.

        The factor is a weighted mean of the single actuators' (the mediant), so the best drives one of them alone.
        """
        energy = self.by_zone[:, list(zones)].sum(axis=1)
        single = np.einsum("faa->fa", energy).real / np.einsum("faa->fa", self.total).real
        at, actuator = np.unravel_index(np.where(self.usable, single, -1.0).argmax(), single.shape)
        alone = np.eye(single.shape[1], dtype=np.complex128)[actuator]
        return BarDrive("different frequencies", np.full(len(alone), self.frequency_hz[at]), alone)

    def best_together(self, zones: Sequence[int]) -> BarDrive:
        """The best drive of one frequency: the greatest generalised eigenvalue of R_S a = lambda T a."""
        found = self.greatest(zones)
        best = int(np.argmax([value for value, _ in found]))
        amplitude = found[best][1]
        amplitude = amplitude / amplitude[abs(amplitude).argmax()]
        return BarDrive("one frequency, with phase", np.full(len(amplitude), self.frequency_hz[best]), amplitude)

    def greatest(self, zones: Sequence[int]) -> list[tuple[float, Complex]]:
        """For each frequency the greatest share of energy in the zones, and its drive (actuator,)."""
        energy = self.by_zone[:, list(zones)].sum(axis=1)
        return [_greatest(*each) for each in zip(energy, self.total, self.usable, strict=True)]


def find_untouched_optima(plant: Plant, zones: Sequence[int]) -> tuple[BarDrive, BarDrive]:
    """The best drive of tones of different frequencies, and the best of one frequency with phases."""
    energy = UntouchedEnergy.of_plant(plant)
    return energy.best_alone(zones), energy.best_together(zones)


def greatest_factors(plant: Plant) -> Array:
    """Shape (zone,): the greatest localized factor of each zone alone, one frequency for all actuators, with phase."""
    energy = UntouchedEnergy.of_plant(plant)
    zones = range(energy.by_zone.shape[1])
    return np.array([max(value for value, _ in energy.greatest([zone])) for zone in zones])


def _greatest(R: Complex, T: Complex, usable: Mask) -> tuple[float, Complex]:
    """The greatest share and its drive (actuator,), of the actuators that may play the frequency."""
    amplitude, which = np.zeros(len(R), dtype=np.complex128), np.flatnonzero(usable)
    if not len(which):
        return -1.0, amplitude
    pick = np.ix_(which, which)
    values, vectors = eigh(R[pick], T[pick])
    amplitude[which] = vectors[:, -1]
    return float(values[-1]), amplitude
