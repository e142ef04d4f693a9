"""What a sensor that stays reads on a simulated bar under bursts of tones. SIMULATED."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from base.arrays import Array
from engine.device import Device
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.model.transient import TransientPlant
from tactable.track.estimator import scaled_finger
from tests.engine.loop.rig import DEVICE

RATE_HZ, FINE = 3_200.0, 8
AT_M, MASS_KG, NOISE_M_PER_S2 = 0.97 * DEVICE.bar.length_m, 2e-3, 0.01
MARGIN, LENGTH = 80, 320
Fingers = Sequence[tuple[float, float]]  # position in metres, factor of the standard finger's impedance


def drifted(scale: float) -> Device:
    """The bar with Young's modulus multiplied."""
    return replace(DEVICE, surface=replace(DEVICE.bar, youngs_modulus_pa=DEVICE.bar.youngs_modulus_pa * scale))


def burst_at(start_s: float, seconds: float, seed: int = 0) -> Array:
    """Drive (time, actuator) at FINE RATE_HZ: 30 ms of tones from 60 to 300 Hz, else 0."""
    time_s = np.arange(round(seconds * RATE_HZ) * FINE) / (RATE_HZ * FINE) - start_s
    window = np.where((time_s > 0) & (time_s < 0.03), np.sin(np.pi * time_s / 0.03), 0.0)
    random = np.random.default_rng(seed)
    hz, phase = random.uniform(60, 300, (2, 3)), random.uniform(0, 2 * np.pi, (2, 3))
    tones = np.sin(2 * np.pi * hz * time_s[:, None, None] + phase).sum(axis=2)
    return np.asarray(window[:, None] * tones / 3)


def sampled(device: Device, fingers: Fingers, drive: Array, gain: float = 1.02, seed: int = 1) -> Array:
    """Samples (sample, 1 + actuator) of the sensor, lying level, for a drive (time, actuator) from rest."""
    weight = replace(device.finger, mass_kg=MASS_KG, damping_n_s_per_m=0.0, stiffness_n_per_m=0.0)
    plant = TransientPlant(compute_basis(assemble(device)), np.array([AT_M]), RATE_HZ * FINE)
    plant.touch([(AT_M, weight), *((at_m, scaled_finger(device.finger, factor)) for at_m, factor in fingers)])
    samples = np.column_stack([gain * plant.accelerate(drive) + 9.81, drive])[::FINE]
    samples[:, 0] += NOISE_M_PER_S2 * np.random.default_rng(seed).standard_normal(len(samples))
    return samples


def window(device: Device, fingers: Fingers, seed: int = 0, start_s: float = 0.03) -> Array:
    """One window, whose burst begins `start_s` after its margin did."""
    return sampled(device, fingers, burst_at(start_s, (MARGIN + LENGTH) / RATE_HZ, seed), seed=seed)
