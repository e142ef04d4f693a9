"""Modes of the untouched surface: what steady drives at any positions are solved from.

Optima are sharp and responses are smooth (docs/theory.md#steady-drives-at-positions), so no drive is stored. The
functions are smooth over the surface, and what moves them is exact at every frequency, so a few functions at places
stand for the receptances between all points.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from base.arrays import Array, Complex, Complex32, Integers, Points, Single
from engine.device import Device
from engine.touch.placement import Places

_CUBIC = 4
_MORE_NODES = 3  # Gauss's nodes beyond one for each radian of a wave along half a side: right to 1e-4
_TOLERANCE = 3e-5  # principal components below it are left out; at each frequency the greatest motion is about 1


@dataclass(frozen=True)
class Modes:
    """Functions over the surface, of which the first are its modes, mass-normalised; and what moves them.

    frequency_hz, threshold_m_per_s2 (frequency,): rising, and the detection threshold there. shape (place, function):
    1/sqrt(kg) for modes, values between places are cubic. drive (function, actuator, frequency): the displacement at a
    point is the sum of shape times drive, metres at full scale. Functions that are no modes carry measured drives.
    natural_frequency_hz, damping_per_s (mode,): a mode's receptance is 1 / (s^2 + damping s + omega^2).
    at_actuator (mode, actuator): shape there. damper_n_s_per_m (actuator,): damping of the mounts that is not in the
    modes' own; it couples them.
    """

    frequency_hz: Array
    threshold_m_per_s2: Array
    places: Places
    shape: Single
    drive: Complex32
    natural_frequency_hz: Array
    damping_per_s: Array
    at_actuator: Array
    damper_n_s_per_m: Array

    @property
    def per_threshold(self) -> Array:
        """Factor (frequency,) from displacement to acceleration over the threshold."""
        return (2 * np.pi * self.frequency_hz) ** 2 / self.threshold_m_per_s2

    @cached_property
    def modal(self) -> Complex:
        """Receptances (mode, frequency) of the modes without the mounts' dampers, m/N kg."""
        s, own = 2j * np.pi * self.frequency_hz, (2 * np.pi * self.natural_frequency_hz) ** 2
        return np.asarray(1 / (s**2 + self.damping_per_s[:, None] * s + own[:, None]), dtype=np.complex128)

    @cached_property
    def damped(self) -> Complex:
        """What the dampers take (mode, damper, frequency): G_mn = modal_m delta_mn - sum_d damped_md damped_nd.

        Each damper is attached by a rank-one update (Sherman and Morrison), the next one to what is left.
        """
        s = 2j * np.pi * self.frequency_hz
        found: Complex = np.zeros((*self.at_actuator.shape, len(s)), dtype=np.complex128)
        for damper, damping in enumerate(self.damper_n_s_per_m):
            shape = self.at_actuator[:, damper]
            column, z = _moved(shape, self.modal, found[:, :damper]), damping * s
            found[:, damper] = column * np.sqrt(z / (1 + z * (shape @ column)))
        return found

    def moved_at_actuators(self) -> Complex:
        """Motion (mode, actuator, frequency) of the modes per newton at each actuator."""
        moved = [_moved(shape, self.modal, self.damped) for shape in self.at_actuator.T]
        return np.array(moved).reshape(-1, *self.modal.shape).swapaxes(0, 1)

    def at(self, points_m: Points) -> Array:
        """The functions at points (...,): (..., function)."""
        places, corner_m = self.places, self.places.corner_m
        grid = self.shape.reshape(places.across, places.along, -1)
        x, along = _cubics(np.real(points_m), corner_m.real, places.along)
        y, across = _cubics(np.imag(points_m), corner_m.imag, places.across)
        return np.einsum("...i,...j,...jim->...m", along, across, grid[y[..., :, None], x[..., None, :]])


def _moved(shape: Array, modal: Complex, damped: Complex) -> Complex:
    """Motion (mode, frequency) of the modes per newton at a point with these mode shapes (mode,)."""
    own = np.einsum("m,mdk->dk", shape, damped)
    return shape[:, None] * modal - np.einsum("mdk,dk->mk", damped, own)


def _cubics(at_m: Array, side_m: float, count: int) -> tuple[Integers, Array]:
    """The places (..., 4) about coordinates (...,) along a side, and the weights of the cubic; of one place, that."""
    nodes = min(_CUBIC, count)
    at = at_m * ((count - 1) / (side_m or 1.0))
    first = np.clip(at.astype(np.int64) - 1, 0, count - nodes)
    x, node = (at - first)[..., None] - np.arange(nodes), np.arange(nodes)
    factors = [[x[..., o] / (k - o) for o in node if o != k] for k in node]
    weight = np.stack([np.prod([np.ones_like(at), *each], axis=0) for each in factors], axis=-1)
    return first[..., None] + node, weight


def energy_points(device: Device) -> tuple[Complex, Array]:
    """Points (point,) of Gauss's rule for the energy of each zone and of the surface: weights (zone + 1, point)."""
    surface, points, weights = device.surface, list[Complex](), list[Array]()
    wave_number = surface.wave_number_per_m(device.sweep.stop_hz)
    stretches = [*((zone.start_m, zone.stop_m) for zone in device.zones), (0 * surface.corner_m, surface.corner_m)]
    for start_m, stop_m in stretches:
        x, along = _gauss(start_m.real, stop_m.real, wave_number)
        y, across = _gauss(start_m.imag, stop_m.imag, wave_number)
        points.append(np.asarray(x + 1j * y[:, None], dtype=np.complex128).ravel())
        weights.append((along * across[:, None]).ravel())
    share, ends = np.zeros((len(points), sum(map(len, points)))), np.cumsum([len(each) for each in points])
    for row, (weight, end) in enumerate(zip(weights, ends.tolist(), strict=True)):
        share[row, end - len(weight) : end] = weight
    return np.concatenate(points), share


def _gauss(start_m: float, stop_m: float, wave_number_per_m: float) -> tuple[Array, Array]:
    """Nodes and weights along one side; a bar has no second one, and a weight of 1."""
    if start_m == stop_m:
        return np.array([start_m]), np.ones(1)
    half_m = (stop_m - start_m) / 2
    node, weight = np.polynomial.legendre.leggauss(int(np.ceil(wave_number_per_m * half_m)) + _MORE_NODES)
    return start_m + half_m * (1 + node), half_m * weight


def held_zones(device: Device, positions_m: Points) -> list[int]:
    """Zones (indices, rising) that hold fingers at these points; a finger in none is held by the nearest."""
    middle_m = np.array([zone.middle_m for zone in device.zones])
    half_m = np.array([(zone.stop_m - zone.start_m) / 2 for zone in device.zones])
    apart_m = np.asarray(positions_m)[:, None] - middle_m
    beyond_m = np.maximum(abs(np.real(apart_m)) - np.real(half_m), abs(np.imag(apart_m)) - np.imag(half_m))
    return sorted({int(zone) for zone in beyond_m.argmin(axis=1)})


class CondensedModes:
    """Modes condensed for the kernels of `engine.steady.loading`: few functions and courses over frequency for all.

    Modes far above the sweep are springs there: their motion differs by a factor alone, and many of them are worth one
    function. Principal components find such functions, and the courses that receptances are made of.

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
