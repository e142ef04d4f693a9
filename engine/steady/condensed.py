"""Modes condensed for the kernels: few functions and few courses over frequency stand for all of them.

Modes far above the sweep are springs there: their motion differs by a factor alone, and many of them are worth one
function. Principal components find such functions, and the courses that receptances are made of.
"""

import numpy as np

from base.arrays import Array, Complex, Points, Single
from engine.steady.modes import Modes

_TOLERANCE = 3e-5  # principal components below it are left out; at each frequency the greatest motion is about 1


class CondensedModes:
    """What `engine.steady.loading` reads, of one device.

    grid (across, along, function): condensed functions of the drive, then mode shapes. drive, damper (function,
    actuator 2 frequency): acceleration over the threshold at full scale, and what the mounts' dampers take.
    spread (mode, line), line (line, 2 frequency): the receptances of modes are spread @ line.
    """

    def __init__(self, modes: Modes) -> None:
        own, (_count, actuators, _) = len(modes.natural_frequency_hz), modes.drive.shape
        taken = np.zeros(modes.drive.shape, dtype=np.complex128)
        taken[:own] = modes.damped
        drive = modes.drive * modes.per_threshold
        size = np.concatenate([np.linalg.norm(drive, axis=0), np.sqrt(abs(modes.modal).max(axis=0))[None]])
        size[size == 0] = 1.0
        moved = np.concatenate([drive, taken], axis=1)
        functions, rows = _components(moved, np.concatenate([size[:-1], np.repeat(size[-1:], actuators, axis=0)]))
        self.drive, self.damper = (_rows(part) for part in np.split(rows, 2, axis=1))
        spread, line = _components(modes.modal, abs(modes.modal).max(axis=0))
        self.spread: Single = np.ascontiguousarray(spread, dtype=np.float32)
        self.line = _rows(line)
        places = modes.places
        values = np.concatenate([modes.shape @ functions, modes.shape[:, :own]], axis=1)
        self.grid: Single = np.ascontiguousarray(values.reshape(places.across, places.along, -1), dtype=np.float32)
        corner_m = places.corner_m
        self._per_m = (places.along - 1) / corner_m.real, (places.across - 1) / (corner_m.imag or 1.0)

    def steps(self, points_m: Points) -> tuple[Array, Array]:
        """Coordinates (...,) of points in steps of the grid."""
        return np.real(points_m) * self._per_m[0], np.imag(points_m) * self._per_m[1]


def _components(values: Complex, size: Array) -> tuple[Array, Complex]:
    """Few components (row, component) and their courses (component, ..., frequency) with values = both's product.

    values (row, ..., frequency); size (..., frequency): what errors are relative to.
    """
    scaled = values / size
    flat = np.concatenate([scaled.real, scaled.imag], axis=-1).reshape(len(values), -1)
    square, vector = np.linalg.eigh(flat @ flat.T)
    kept = vector[:, square > _TOLERANCE**2]
    return kept, np.tensordot(kept.T, values, axes=1)


def _rows(values: Complex) -> Single:
    """Real and imaginary parts (row, ... 2 frequency) of values (row, ..., frequency)."""
    return np.ascontiguousarray(np.stack([values.real, values.imag], axis=-2).reshape(len(values), -1), np.float32)
