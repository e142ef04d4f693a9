"""Reach: the greatest acceleration that each place of a surface can be given, and so its dead zones."""

from dataclasses import dataclass

import numpy as np

from base.arrays import Array, Points
from engine.device import Finger
from engine.device.quantity import GRAVITY_M_PER_S2
from precompute.model.frequencies import fine_frequencies, in_band
from precompute.model.plant import Plant
from precompute.model.response import solve_response

_CHUNK = 64  # frequencies at a time: fields of 150 columns in 256 elements take 80 MB


@dataclass(frozen=True)
class Reach:
    """The greatest acceleration of each place (place,) at full scale, m/s^2, and the drive that gives it.

    tones: every actuator at the frequency tones_hz (place, actuator) that suits it best, magnitudes added (paper
    eq. (8)): no drive of one tone an actuator gives more. one_tone: all at one_tone_hz, in phase there. level_db: the
    greatest sensation level, dB above the detection threshold, of drives of these two kinds.
    """

    position_m: Points
    tones: Array
    tones_hz: Array
    one_tone: Array
    one_tone_hz: Array
    level_db: Array


def compute_reach(plant: Plant, position_m: Points, finger: Finger | None = None) -> Reach:
    """Reach of each of position_m (place,), untouched, or under a `finger` that lies there and nowhere else."""
    frequency_hz = fine_frequencies(plant)
    each = _accelerations(plant, frequency_hz, position_m, finger)
    together = each.sum(axis=1)
    over_threshold = 1 / plant.device.threshold.peak_m_per_s2(frequency_hz)
    one_power = (together * over_threshold[:, None]).max(axis=0) ** 2
    own_power = ((each * over_threshold[:, None, None]).max(axis=0) ** 2).sum(axis=0)
    return Reach(
        position_m=position_m,
        tones=each.max(axis=0).sum(axis=0),
        tones_hz=frequency_hz[each.argmax(axis=0)].T,
        one_tone=together.max(axis=0),
        one_tone_hz=frequency_hz[together.argmax(axis=0)],
        level_db=10 * np.log10(np.maximum(one_power, own_power)),
    )


def compute_acceleration_curves(plant: Plant, position_m: Points, finger: Finger | None = None) -> tuple[Array, Array]:
    """Frequencies (frequency,) in Hz, 1 Hz apart in the bands, and peak accelerations (frequency, place) in g.

    All actuators play one frequency in phase at the place, each within its band and its limits.
    """
    bands = [actuator.band_hz for actuator in plant.device.actuators]
    first, last = np.ceil(min(low for low, _ in bands)), np.floor(max(high for _, high in bands))
    frequency_hz = np.arange(first, last + 1)
    curves: Array = _accelerations(plant, frequency_hz, position_m, finger).sum(axis=1) / GRAVITY_M_PER_S2
    return frequency_hz, curves


def _accelerations(plant: Plant, frequency_hz: Array, position_m: Points, finger: Finger | None) -> Array:
    """Magnitudes (frequency, actuator, place) at the amplitude limit, m/s^2; 0 beyond an actuator's band."""
    actuators, places = len(plant.device.actuators), len(position_m)
    sampler, at = plant.sampler(position_m), np.arange(places)
    out = np.empty((len(frequency_hz), actuators, places))
    for start in range(0, len(frequency_hz), _CHUNK):
        part = slice(start, start + _CHUNK)
        omega = 2 * np.pi * frequency_hz[part, None]
        response = solve_response(plant, frequency_hz[part], None if finger is None else position_m)
        moved = sampler.sample(response.displacement_m)
        out[part] = abs(moved[:, :actuators]) * (omega**2)[:, :, None]
        if finger is not None:
            # Alone at its place a finger of dynamic stiffness Z divides by 1 + Y Z, Y the receptance there.
            Z = finger.stiffness_n_per_m + 1j * omega * finger.damping_n_s_per_m - omega**2 * finger.mass_kg
            out[part] /= abs(1 + moved[:, actuators + at, at] * Z)[:, None]
    out *= plant.device.limits.amplitude
    out[~in_band(plant.device, frequency_hz)] = 0.0
    return out
