"""A surface to where its theory ends: shortest wave, shear and rotary inertia there, a bar's first torsional mode."""

import math

from engine.device import Device
from engine.device.parts import Bar

_POISSON, _SHEAR_FACTOR = 0.33, 5 / 6  # of metals, ESTIMATE; of a rectangle


def shortest_wave_m(device: Device) -> float:
    """Length of a free bending wave at the end of the sweep."""
    return 2 * math.pi / device.surface.wave_number_per_m(device.sweep.stop_hz)


def estimate_shear_error(device: Device) -> float:
    """Relative error by which natural frequencies at the end of the sweep are too high, ESTIMATE.

    First order in (k h)^2 of Timoshenko's dispersion (Phil. Mag. 41, 1921): (k h)^2 / 24 (1 + E / (kappa G)). On a
    plate E / (1 - nu^2) takes the place of E (Mindlin, J. Appl. Mech. 18, 1951).
    """
    surface = device.surface
    kh = 2 * math.pi * surface.thickness_m / shortest_wave_m(device)
    over_shear = 2 * (1 + _POISSON) if isinstance(surface, Bar) else 2 / (1 - surface.poissons_ratio)
    return kh**2 / 24 * (1 + over_shear / _SHEAR_FACTOR)


def estimate_torsion_hz(device: Device) -> float | None:
    """Frequency of the first torsional mode of the free bar without actuators, Hz, ESTIMATE (Saint-Venant).

    None for a plate, whose theory has its twisting modes.
    """
    bar = device.surface
    if not isinstance(bar, Bar):
        return None
    thin, wide = sorted((bar.width_m, bar.thickness_m))
    stiffness = wide * thin**3 * (1 / 3 - 0.21 * thin / wide) * bar.youngs_modulus_pa / (2 * (1 + _POISSON))
    inertia = bar.density_kg_per_m3 * wide * thin * (wide**2 + thin**2) / 12
    return math.sqrt(stiffness / inertia) / (2 * bar.length_m)
