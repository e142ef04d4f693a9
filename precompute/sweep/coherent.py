"""Coherent sweep: what the surface does under many complex amplitude vectors ("directions") at one frequency."""

from dataclasses import dataclass

import numpy as np

from base.arrays import Complex, Mask, Single
from precompute.sweep.grid import GridResponse
from precompute.sweep.sweep_kernels import AmplitudeRatios, fill_coherent_sweep


@dataclass(frozen=True)
class CoherentFigures:
    """Per frequency, zone and direction, shape (frequency, zone, direction); peak and dead in m/s^2.

    Where a direction drives an actuator outside its band, `allowed` (frequency, direction) is False.
    """

    factor: Single
    peak: Single
    dead: Single
    allowed: Mask


def pair_directions(actuators: int, pair: tuple[int, int], ratios: AmplitudeRatios, phase_steps: int) -> Complex:
    """Shape (actuator, ratio * phase): both actuators of a pair, the stronger at full scale, phase on the second."""
    phase = np.exp(2j * np.pi * np.arange(phase_steps) / phase_steps)
    strongest = np.maximum(ratios.first, ratios.second)
    out = np.zeros((actuators, len(strongest), phase_steps), dtype=np.complex128)
    out[pair[0]] = (ratios.first / strongest)[:, None]
    out[pair[1]] = (ratios.second / strongest)[:, None] * phase
    return out.reshape(actuators, -1)


def compute_coherent_figures(grid: GridResponse, directions: Complex) -> CoherentFigures:
    """Localized factor, peak and dead spot of every zone under every direction, at every frequency of the grid."""
    shape = (len(grid.frequency_hz), len(grid.device.zones), directions.shape[1])
    factor, peak, dead = (np.empty(shape, dtype=np.float32) for _ in range(3))
    unit = np.einsum("fii->f", grid.total).real.max()  # the kernel is in single precision
    fields = (grid.acceleration, grid.gram / unit, grid.total / unit, directions)
    fill_coherent_sweep(*(part for field in fields for part in _split(field)), factor, peak, dead)
    allowed = ~((~grid.in_band).astype(np.int64) @ (abs(directions) > 0).astype(np.int64)).astype(bool)
    return CoherentFigures(factor, peak, dead, allowed)


def _split(values: Complex) -> tuple[Single, Single]:
    return np.ascontiguousarray(values.real, dtype=np.float32), np.ascontiguousarray(values.imag, dtype=np.float32)
