"""Measurements for tests: drives at places of a device, and readings that a device with known values would give."""

from collections.abc import Sequence

import numpy as np

from engine.device import Device
from precompute.measurements.model import Flaws, even_places, simulate_measurements
from precompute.measurements.parameters import with_changes
from precompute.measurements.types import Kind, Measurements, lay_out

NAN = float("nan")
SENSOR_MASS_KG = 2e-3
PAIRS_HZ = ((150, 130), (150, 200), (150, 230), (120, 180), (180, 210), (210, 120), (100, 250))
"""The paper's three, then others in its band."""
TRUTH = {
    "actuator[1].stiffness": 21.3e3,
    "actuator[2].stiffness": 16.1e3,
    "actuator.damping": 0.06,
    "actuator.full_scale": 0.47e-6,
    "bar.mass_damping": 3.0,
    "bar.stiffness_damping": 7e-5,
}
"""What a bar like reference-a may have become."""


def read_bar(
    device: Device,
    truth: dict[str, float],
    pairs_hz: Sequence[Sequence[float]] = PAIRS_HZ[:3],
    flaws: Flaws | None = None,
    *,
    points: int = 22,
    kind: Kind = Kind.PEAK,
    seed: int = 1,
    sensor_mass_kg: float = SENSOR_MASS_KG,
) -> Measurements:
    layout = lay_out(np.array(pairs_hz, dtype=np.float64), even_places(device, points), sensor_mass_kg, kind)
    return simulate_measurements(with_changes(device, truth), layout, flaws or Flaws(), seed)
