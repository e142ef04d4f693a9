"""The plant once more, plainly: dense matrices, one np.linalg.solve a frequency, Simpson's rule on fine places.

Shares nothing with precompute: element matrices come from integrating the Hermite polynomials, energies from
quadrature of the field, peaks from looking at many places.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.polynomial import Polynomial
from scipy.integrate import simpson

from base.arrays import Array, Complex
from engine.device import Device, Finger

Fingers = Sequence[tuple[complex, Finger]]


@dataclass(frozen=True)
class Figures:
    """Per zone: share of the kinetic energy, greatest and least acceleration amplitude in m/s^2."""

    share: Array
    peak: Array
    dead: Array


def drive_of(device: Device, coherent: bool) -> tuple[Array, Complex]:
    """One tone of all actuators, or one each; in whole hertz, so that a second holds whole periods and beats."""
    count = len(device.actuators)
    hz = np.full(count, 187.0) if coherent else np.array([104.0, 243.0, 171.0])[:count]
    return hz, np.array([0.8, 0.5j - 0.3, -0.6])[:count]


class DenseModel:
    """One device with fingers on it, as full matrices; degrees of freedom are deflection and slope of each node."""

    def __init__(self, device: Device, fingers: Fingers = ()) -> None:
        self.device = device
        self.node_m = _nodes(device)
        size = 2 * len(self.node_m)
        bar = device.bar
        bending = bar.youngs_modulus_pa * bar.width_m * bar.thickness_m**3 / 12
        line_mass = bar.density_kg_per_m3 * bar.width_m * bar.thickness_m
        self.K, self.M = np.zeros((size, size)), np.zeros((size, size))
        for e, length_m in enumerate(np.diff(self.node_m)):
            part = slice(2 * e, 2 * e + 4)
            self.K[part, part] += bending * element_integral(round(length_m, 15), derivative=2)
            self.M[part, part] += line_mass * element_integral(round(length_m, 15), derivative=0)
        self.C = bar.mass_damping_per_s * self.M + bar.stiffness_damping_s * self.K
        sigma, eta = (bar.mass_damping_per_s, bar.stiffness_damping_s) if bar.damping_of == "assembly" else (0.0, 0.0)
        self.spring, self.damper = (np.zeros((size, len(device.actuators))) for _ in range(2))
        for i, actuator in enumerate(device.actuators):
            row = self.rows([actuator.position_m.real])[0]
            m, c, k = actuator.mass_kg, actuator.damping_n_s_per_m, actuator.stiffness_n_per_m
            self._ground(row, m, c + sigma * m + eta * k, k)
            self.spring[:, i] = row * actuator.stiffness_n_per_m * actuator.full_scale_m
            self.damper[:, i] = row * actuator.damping_n_s_per_m * actuator.full_scale_m
        self._touch(fingers)

    def touched(self, fingers: Fingers) -> "DenseModel":
        """The same bar with these fingers on it too, assembled into its matrices."""
        other = copy(self)
        other._touch(fingers)
        return other

    def _touch(self, fingers: Fingers) -> None:
        for position_m, finger in fingers:
            row = self.rows([position_m.real])[0]
            self._ground(row, finger.mass_kg, finger.damping_n_s_per_m, finger.stiffness_n_per_m)

    def _ground(self, row: Array, mass_kg: float, damping_n_s_per_m: float, stiffness_n_per_m: float) -> None:
        outer = np.outer(row, row)
        self.M = self.M + mass_kg * outer
        self.C = self.C + damping_n_s_per_m * outer
        self.K = self.K + stiffness_n_per_m * outer

    def rows(self, position_m: Sequence[float] | Array) -> Array:
        """Shape (place, degree of freedom): what the deflection at a place takes of each degree of freedom."""
        place_m = np.asarray(position_m, dtype=np.float64)
        out = np.zeros((len(place_m), 2 * len(self.node_m)))
        element = np.clip(np.searchsorted(self.node_m, place_m, side="right") - 1, 0, len(self.node_m) - 2)
        for e in np.unique(element):
            here = np.flatnonzero(element == e)
            shapes = hermite(self.node_m[e + 1] - self.node_m[e])
            out[here, 2 * e : 2 * e + 4] = np.column_stack([shape(place_m[here] - self.node_m[e]) for shape in shapes])
        return out

    def unit_field(self, frequency_hz: Array) -> Complex:
        """Shape (frequency, degree of freedom, actuator): acceleration of one actuator at full scale."""
        omega = 2 * np.pi * np.asarray(frequency_hz)[:, None, None]
        matrix = self.K + 1j * omega * self.C - omega**2 * self.M
        field = -(omega**2) * np.linalg.solve(matrix, self.spring + 1j * omega * self.damper)
        return np.asarray(field, dtype=np.complex128)

    def unit_acceleration(self, frequency_hz: Array, position_m: Array) -> Complex:
        """Shape (frequency, place, actuator), m/s^2 with one actuator at full scale, the others still."""
        acceleration: Complex = self.rows(position_m) @ self.unit_field(frequency_hz)
        return acceleration

    def figures(self, frequency_hz: Array, amplitude: Complex, points: int = 801) -> Figures:
        """Steady state of a drive: tones of one frequency add as fields, others as magnitudes and energies."""
        tones = np.unique(frequency_hz[amplitude != 0])
        weight = np.where(frequency_hz == tones[:, None], amplitude, 0)
        field = np.einsum("tda,ta->td", self.unit_field(tones), weight)
        squared = ((2 * np.pi * tones) ** 2)[:, None]

        def look(start_m: float, stop_m: float, count: int) -> tuple[float, Array]:
            place_m = np.linspace(start_m, stop_m, count)
            level = abs(field @ self.rows(place_m).T)
            return float(simpson((level**2 / squared).sum(axis=0), x=place_m)), level.sum(axis=0)

        total, _ = look(0.0, self.device.bar.length_m, 8001)
        zones = [look(zone.start_m.real, zone.stop_m.real, points) for zone in self.device.zones]
        return Figures(
            share=np.array([energy for energy, _ in zones]) / total,
            peak=np.array([level.max() for _, level in zones]),
            dead=np.array([level.min() for _, level in zones]),
        )

    def unit_gram(self, frequency_hz: Array, start_m: float, stop_m: float, count: int = 401) -> Complex:
        """Shape (frequency, actuator, actuator): integral over a stretch of conj(v_a) v_b, v the unit velocities."""
        place_m = np.linspace(start_m, stop_m, count)
        velocity = self.unit_acceleration(frequency_hz, place_m) / (2 * np.pi * frequency_hz[:, None, None])
        weight = np.where(np.arange(count) % 2, 4.0, 2.0) * (place_m[1] - place_m[0]) / 3  # Simpson's rule
        weight[[0, -1]] /= 2
        gram: Complex = np.einsum("fpa,p,fpb->fab", velocity.conj(), weight, velocity, optimize=True)
        return gram


def _nodes(device: Device) -> Array:
    """A node at every actuator and zone edge, no element longer than the device asks for."""
    length_m = device.bar.length_m
    places = [0.0, length_m, *(actuator.position_m for actuator in device.actuators)]
    places += [edge for zone in device.zones for edge in (zone.start_m, zone.stop_m)]
    forced = np.unique(np.round(np.array(places) / length_m, 9)) * length_m
    counts = np.ceil(np.diff(forced) / device.bar.largest_element_m - 1e-9).astype(int)
    spans = zip(forced[:-1], forced[1:], counts, strict=True)
    return np.append(np.concatenate([np.linspace(a, b, n, endpoint=False) for a, b, n in spans]), length_m)


def hermite(length_m: float) -> list[Polynomial]:
    """The cubics with value and slope (1, 0, 0, 0), (0, 1, 0, 0) ... at the two ends of an element."""
    a = length_m
    at_ends = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [1, a, a**2, a**3], [0, 1, 2 * a, 3 * a**2]])
    return [Polynomial(column) for column in np.linalg.inv(at_ends).T]


@cache
def element_integral(length_m: float, derivative: int) -> Array:
    """Shape (4, 4): integral over an element of the products of its shapes' derivatives. Most lengths come often."""
    return integral(hermite(length_m), length_m, derivative)


def integral(shapes: list[Polynomial], length_m: float, derivative: int) -> Array:
    """Shape (4, 4): integral over the element of the products of the shapes' derivatives."""
    derived = [shape.deriv(derivative) if derivative else shape for shape in shapes]
    return np.array([[(one * other).integ()(length_m) for other in derived] for one in derived])
