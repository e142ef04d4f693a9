"""Drives with the greatest share of energy in some zones of the untouched bar, paper eq. (11)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from precompute.entries.found_drive import full_scale
from precompute.model.assembly import Plant
from precompute.model.frequencies import fine_frequencies, in_band
from precompute.model.gram import compute_gram
from precompute.model.response import solve_response

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class BarDrive:
    """One tone an actuator, frequency_hz and amplitude (actuator,), complex, at full scale; `name` says whose it is."""

    name: str
    frequency_hz: Array
    amplitude: Complex


def find_untouched_optima(plant: Plant, zones: Sequence[int]) -> tuple[BarDrive, BarDrive]:
    """The best drive of tones of different frequencies, and the best of one frequency with phases.

    Different frequencies: the factor is a weighted mean of the single actuators' (the mediant), so the best
    drives one of them alone. One frequency: the greatest generalised eigenvalue of R_S a = lambda T a. Both over
    `fine_frequencies` (docs/theory.md#objective-and-bound).
    """
    frequency_hz = fine_frequencies(plant)
    gram, total = compute_gram(solve_response(plant, frequency_hz))
    energy, usable = gram[:, list(zones)].sum(axis=1), in_band(plant.device, frequency_hz)
    single = np.einsum("faa->fa", energy).real / np.einsum("faa->fa", total).real
    at, actuator = np.unravel_index(np.where(usable, single, -1.0).argmax(), single.shape)
    alone = np.eye(single.shape[1], dtype=np.complex128)[actuator]
    together = [_greatest(R, T, usable_here) for R, T, usable_here in zip(energy, total, usable, strict=True)]
    best = int(np.argmax([value for value, _ in together]))
    return (
        BarDrive("different frequencies", np.full(len(alone), frequency_hz[at]), alone),
        BarDrive("one frequency, with phase", np.full(len(alone), frequency_hz[best]), full_scale(together[best][1])),
    )


def greatest_factors(plant: Plant) -> Array:
    """Shape (zone,): the greatest localized factor of each zone alone, one frequency for all actuators, with phase."""
    frequency_hz = fine_frequencies(plant)
    gram, total = compute_gram(solve_response(plant, frequency_hz))
    usable, by_zone = in_band(plant.device, frequency_hz), gram.transpose(1, 0, 2, 3)
    return np.array([max(_greatest(*each)[0] for each in zip(R, total, usable, strict=True)) for R in by_zone])


def _greatest(R: Complex, T: Complex, usable: NDArray[np.bool_]) -> tuple[float, Complex]:
    """The greatest share and its drive (actuator,), of the actuators that may play the frequency."""
    amplitude, which = np.zeros(len(R), dtype=np.complex128), np.flatnonzero(usable)
    if not len(which):
        return -1.0, amplitude
    pick = np.ix_(which, which)
    values, vectors = eigh(R[pick], T[pick])
    amplitude[which] = vectors[:, -1]
    return float(values[-1]), amplitude
