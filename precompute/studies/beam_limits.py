"""A bar to where its theory ends: shear and rotary inertia at the end of the band, and its first torsional mode."""

import math

from engine.device import Device

_POISSON, _SHEAR_FACTOR = 0.33, 5 / 6  # of metals, ESTIMATE; of a rectangle


def estimate_shear_error(device: Device) -> float:
    """Relative error by which natural frequencies at the end of the sweep are too high, ESTIMATE.

    First order in (k h)^2 of Timoshenko's dispersion (Phil. Mag. 41, 1921): (k h)^2 / 24 (1 + E / (kappa G)).
    """
    bar, omega = device.bar, 2 * math.pi * device.sweep.stop_hz
    kh_squared = omega * bar.thickness_m * math.sqrt(12 * bar.density_kg_per_m3 / bar.youngs_modulus_pa)
    return kh_squared / 24 * (1 + 2 * (1 + _POISSON) / _SHEAR_FACTOR)


def estimate_torsion_hz(device: Device) -> float:
    """Frequency of the first torsional mode of the free bar without actuators, Hz, ESTIMATE (Saint-Venant)."""
    bar, thin = device.bar, min(device.bar.width_m, device.bar.thickness_m)
    wide = max(bar.width_m, bar.thickness_m)
    stiffness = wide * thin**3 * (1 / 3 - 0.21 * thin / wide) * bar.youngs_modulus_pa / (2 * (1 + _POISSON))
    inertia = bar.density_kg_per_m3 * wide * thin * (wide**2 + thin**2) / 12
    return math.sqrt(stiffness / inertia) / (2 * bar.length_m)
