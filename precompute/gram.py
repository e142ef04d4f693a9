"""Unit responses to zone Gram matrices: everything a localized factor needs, n_actuator squared numbers a zone."""

import numpy as np
from numpy.typing import NDArray

from engine.device import Zone
from precompute.beam import shape_integral
from precompute.response import Response

Gram = NDArray[np.complex128]


def compute_zone_gram(response: Response) -> Gram:
    """R_z = omega^2 G^H Z_z G, shape (frequency, zone, actuator, actuator), Hermitian (PHYSICS.md section 2).

    Proportional to the kinetic energy of the zone; the constants cancel in the localized factor, paper eq. (10).
    """
    element = _element_gram(response)
    plant = response.plant
    middle_m = (plant.node_m[:-1] + plant.node_m[1:]) / 2
    return np.stack([element[:, _inside(zone, middle_m)].sum(axis=1) for zone in plant.device.zones], axis=1)


def compute_total_gram(response: Response) -> Gram:
    """T, the same over the whole bar (zones need not cover it): shape (frequency, actuator, actuator)."""
    total: Gram = _element_gram(response).sum(axis=1)
    return total


def _inside(zone: Zone, middle_m: NDArray[np.float64]) -> NDArray[np.bool_]:
    return (middle_m > zone.start_m) & (middle_m < zone.stop_m)


def _element_gram(response: Response) -> Gram:
    """Shape (frequency, element, actuator, actuator)."""
    plant = response.plant
    integral = np.stack([shape_integral(length_m) for length_m in np.diff(plant.node_m)])
    columns = 2 * np.arange(len(integral))[:, None] + np.arange(4)
    field = response.displacement_m[:, :, columns] * (2 * np.pi * response.frequency_hz)[:, None, None, None]
    weighted = np.einsum("eij,faej->faei", integral, field)
    return np.einsum("faei,fbei->feab", field.conj(), weighted)
