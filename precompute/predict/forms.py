"""Hermitian forms of a drive with fingers on the bar: power under each finger and energy of each zone, as a^H H a.

Fingers are added by a low-rank update of the receptance at the points they touch. With Y the receptance there and Z
their dynamic stiffness, the bar moves as (1 + Y Z)^-1 y_0 under them, and carries their forces -Z y everywhere else.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import types
from numpy.typing import NDArray

from engine.compiled import njit
from precompute.model.frequencies import in_band
from precompute.sampling.receptance import Receptance

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Forms:
    """Hermitian forms of one set of touched zones, each (..., frequency, actuator, actuator).

    level (finger): power of the acceleration under the standard finger over the detection threshold; expected
    (finger): the same, averaged over the sampled cases; energy (zone) and total: Gram matrices with the standard
    fingers on the bar; bar_mean: power over the threshold, averaged along the bar; untouched_energy (zone) and
    untouched_total: Gram matrices without fingers. in_band (frequency, actuator).
    """

    touched: tuple[int, ...]
    frequency_hz: Array
    level: Complex
    expected: Complex
    energy: Complex
    total: Complex
    bar_mean: Complex
    untouched_energy: Complex
    untouched_total: Complex
    in_band: NDArray[np.bool_]


def compute_forms(receptance: Receptance, touched: Sequence[int]) -> Forms:
    """Forms with a finger in every zone of `touched` (indices)."""
    device = receptance.plant.device
    zones = np.array(touched, dtype=np.int64)
    loaded = compute_loaded(receptance, touched)
    omega = 2 * np.pi * receptance.frequency_hz
    weight = (omega**2 / device.threshold.peak_m_per_s2(receptance.frequency_hz)) ** 2
    standard, sampled = loaded[:, 0], loaded[:, 1:]
    energy, total = _loaded_gram(receptance, zones, standard)
    actuators = len(device.actuators)
    return Forms(
        touched=tuple(touched),
        frequency_hz=receptance.frequency_hz,
        level=np.einsum("fza,fzb,f->zfab", standard.conj(), standard, weight, optimize=True),
        expected=_mean_power(sampled) * weight[None, :, None, None],
        energy=energy,
        total=total,
        bar_mean=total * (weight / omega**2)[:, None, None] / device.bar.length_m,
        untouched_energy=np.ascontiguousarray(receptance.zone_gram[:, :, :actuators, :actuators].transpose(1, 0, 2, 3)),
        untouched_total=receptance.total_gram[:, :actuators, :actuators],
        in_band=in_band(device, receptance.frequency_hz),
    )


def compute_loaded(receptance: Receptance, touched: Sequence[int]) -> Complex:
    """Displacement under each finger, (frequency, case, finger, actuator) in metres at full scale, all fingers on."""
    sampled = receptance.sampled
    zones = np.array(touched, dtype=np.int64)
    place = np.ascontiguousarray(zones * sampled.position_m.shape[1] + sampled.place[:, zones])
    stiffness = sampled.dynamic_stiffness(receptance.frequency_hz)[:, :, zones].copy(order="C")
    out = np.empty((*stiffness.shape, receptance.drive.shape[2]), dtype=np.complex128)
    _fill_loaded(receptance.drive, receptance.point, place, stiffness, out)
    return out


def _loaded_gram(receptance: Receptance, zones: NDArray[np.int64], standard: Complex) -> tuple[Complex, Complex]:
    """Gram matrices (zone, frequency, actuator, actuator) and of the whole bar, standard fingers on."""
    frequencies, actuators = receptance.drive.shape[0], receptance.drive.shape[2]
    stiffness = receptance.sampled.dynamic_stiffness(receptance.frequency_hz)[:, 0, zones]
    shape = np.zeros((frequencies, receptance.total_gram.shape[1], actuators), dtype=np.complex128)
    shape[:, :actuators] = np.eye(actuators)
    shape[:, actuators + zones] = -stiffness[:, :, None] * standard
    turned = shape.conj().transpose(0, 2, 1)
    energy = turned[:, None] @ receptance.zone_gram @ shape[:, None]
    return np.ascontiguousarray(energy.transpose(1, 0, 2, 3)), turned @ receptance.total_gram @ shape


def _mean_power(displacement: Complex) -> Complex:
    """Mean over cases of conj(y_a) y_b: (finger, frequency, actuator, actuator)."""
    by_finger = displacement.transpose(2, 0, 1, 3)
    mean: Complex = by_finger.conj().transpose(0, 1, 3, 2) @ by_finger / displacement.shape[1]
    return mean


_FIELD = types.Array(types.complex128, 3, "C", readonly=True)
_PLACE = types.Array(types.int64, 2, "C", readonly=True)
_OUT = types.Array(types.complex128, 4, "C")


@njit(cache=True)
def _eliminate(left, right):  # type: ignore[no-untyped-def]  # numba
    """Solve left x = right in place, x in `right`, with partial pivoting."""
    size, columns = right.shape
    for j in range(size):
        # Exchange rows for the greatest pivot, then eliminate below it.
        pivot = j
        for i in range(j + 1, size):
            if abs(left[i, j]) > abs(left[pivot, j]):
                pivot = i
        if pivot != j:
            for q in range(size):
                left[j, q], left[pivot, q] = left[pivot, q], left[j, q]
            for a in range(columns):
                right[j, a], right[pivot, a] = right[pivot, a], right[j, a]
        for i in range(j + 1, size):
            factor = left[i, j] / left[j, j]
            for q in range(j + 1, size):
                left[i, q] -= factor * left[j, q]
            for a in range(columns):
                right[i, a] -= factor * right[j, a]
    # Back substitution.
    for j in range(size - 1, -1, -1):
        for a in range(columns):
            right[j, a] /= left[j, j]
            for i in range(j):
                right[i, a] -= left[i, j] * right[j, a]


@njit(types.void(_FIELD, _FIELD, _PLACE, _FIELD, _OUT), cache=True)
def _fill_loaded(drive, point, place, stiffness, out):  # type: ignore[no-untyped-def]  # numba
    """Fill out (frequency, case, finger, actuator) with (1 + Y Z)^-1 y_0, by elimination; Y Z is small."""
    cases, fingers = place.shape
    actuators = drive.shape[2]
    for f in range(drive.shape[0]):
        left = np.empty((fingers, fingers), dtype=np.complex128)
        for k in range(cases):
            right = out[f, k]
            for p in range(fingers):
                for q in range(fingers):
                    left[p, q] = point[f, place[k, p], place[k, q]] * stiffness[f, k, q]
                left[p, p] += 1.0
                for a in range(actuators):
                    right[p, a] = drive[f, place[k, p], a]
            _eliminate(left, right)
