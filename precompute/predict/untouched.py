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


def find_untouched_optima(plant: Plant, zones: Sequence[int]) -> tuple[BarDrive, BarDrive]:
    """The best drive of tones of different frequencies, and the best of one frequency with phases.

    Of different frequencies the factor is a weighted mean of the single actuators' (the mediant), so the best drives
    one of them alone. Of one frequency it is the greatest generalised eigenvalue of R_S a = lambda T a.
    """
    hz, by_zone, total, usable = _energies(plant)
    energy = by_zone[:, list(zones)].sum(axis=1)
    single = np.einsum("faa->fa", energy).real / np.einsum("faa->fa", total).real
    at, actuator = np.unravel_index(np.where(usable, single, -1.0).argmax(), single.shape)
    alone = np.eye(single.shape[1], dtype=np.complex128)[actuator]
    found = [_greatest(*each) for each in zip(energy, total, usable, strict=True)]
    best = int(np.argmax([value for value, _ in found]))
    together = found[best][1] / found[best][1][abs(found[best][1]).argmax()]
    return (
        BarDrive("different frequencies", np.full(len(alone), hz[at]), alone),
        BarDrive("one frequency, with phase", np.full(len(alone), hz[best]), together),
    )


def greatest_factors(plant: Plant) -> Array:
    """Shape (zone,): the greatest localized factor of each zone alone, one frequency for all actuators, with phase."""
    _, by_zone, total, usable = _energies(plant)
    each = by_zone.swapaxes(0, 1)
    return np.array([max(_greatest(*line)[0] for line in zip(zone, total, usable, strict=True)) for zone in each])


def _energies(plant: Plant) -> tuple[Array, Complex, Complex, Mask]:
    """Frequencies (frequency,), Gram matrices of the zones and of the whole, and which actuators may play each."""
    hz = fine_frequencies(plant)
    return hz, *compute_gram(solve_response(plant, hz)), in_band(plant.device, hz)


def _greatest(R: Complex, T: Complex, usable: Mask) -> tuple[float, Complex]:
    """The greatest share and its drive (actuator,), of the actuators that may play the frequency."""
    amplitude, which = np.zeros(len(R), dtype=np.complex128), np.flatnonzero(usable)
    if not len(which):
        return -1.0, amplitude
    pick = np.ix_(which, which)
    values, vectors = eigh(R[pick], T[pick])
    amplitude[which] = vectors[:, -1]
    return float(values[-1]), amplitude
