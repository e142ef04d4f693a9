"""Finite-element model of a bar: conforming mesh of Euler-Bernoulli elements, banded stiffness, damping and mass.

An element has cubic Hermite shape functions; its degrees of freedom are deflection and slope at each end.

A clamp of an actuator is exactly rigid: its nodes share the deflection and the slope at the actuator (`_join`). The
obvious other way, elements that are stiffer by a factor, needs 1e4 for frequencies right to 3e-5; a node 0.1 mm from
another then loses the first mode to rounding (docs/theory.md#bolts-that-clamp).
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Self

import numpy as np

from base.arrays import Array, Complex, Integers, Points
from engine.device import Device, Finger
from engine.device.parts import Bar, DeviceError
from precompute.model.plant import FreeSurface, KnownDrive, Plant, Sampler

BANDWIDTH = 3  # Super-diagonals of the assembled matrices: neighbouring nodes couple, two degrees of freedom each
_SNAP = 3e-4
"""Places closer than this fraction of the bar share a node, that of the first in `build_mesh`.

A shorter element costs digits: one of 1e-4 of `reference-a` changes its first mode by up to 2e-3, one of 3e-5 by 6 %.
"""


@dataclass(frozen=True)
class BarPlant(Plant):
    """Assembled bar. K, C, M are symmetric, in upper band form (BANDWIDTH + 1, degree of freedom) as LAPACK's."""

    device: Device
    node_m: Array
    K: Array
    C: Array
    M: Array
    known: KnownDrive | None = None

    @property
    def size(self) -> int:
        """Number of degrees of freedom."""
        return self.K.shape[1]

    @cached_property
    def actuator_dof(self) -> Integers:
        """Shape (actuator,): the deflection that each actuator drives."""
        places = [actuator.position_m for actuator in self.device.actuators]
        nodes: Integers = np.abs(self.node_m[:, None] - places).argmin(axis=0)
        return 2 * _bodies(self.device, self.node_m)[0][nodes]

    @property
    def actuators(self) -> Sampler:
        """The deflection at each actuator, which its spring and damper act on."""
        return Sampler(self.actuator_dof[:, None], np.ones((len(self.actuator_dof), 1)))

    @property
    def masses(self) -> Sampler:
        """The deflection of each mass of `moved_masses`: those at the actuators."""
        return self.actuators

    @cached_property
    def _joined(self) -> tuple[Integers, Array]:
        return _join(self.device, self.node_m)

    @cached_property
    def element_dof(self) -> Integers:
        """Shape (element, 4): the degrees of freedom that each element moves with."""
        return self._joined[0][:, None] + np.arange(4)

    @cached_property
    def element_integral(self) -> Array:
        """Shape (element, 4, 4): integral of N N^T over each element by `element_dof`, in metres."""
        own = np.stack([shape_integral(length_m) for length_m in np.diff(self.node_m)])
        return _moved(own, self._joined[1])

    @cached_property
    def element_zone(self) -> Integers:
        """Shape (element,): index of the zone that holds it; the number of zones where none does."""
        middle_m = (self.node_m[:-1] + self.node_m[1:]) / 2
        out = np.full(len(middle_m), len(self.device.zones), dtype=np.int64)
        for index, zone in enumerate(self.device.zones):
            out[(middle_m > zone.start_m) & (middle_m < zone.stop_m)] = index
        return out

    def sampler(self, position_m: Array | Complex) -> Sampler:
        """Sampler at positions (point,) on the bar."""
        position_m = np.asarray(position_m, dtype=np.float64)
        element = np.clip(np.searchsorted(self.node_m, position_m, side="right") - 1, 0, len(self.node_m) - 2)
        length_m = np.diff(self.node_m)[element]
        weight = shape_functions((position_m - self.node_m[element]) / length_m, length_m)
        return Sampler(self.element_dof[element], np.einsum("pi,pik->pk", weight, self._joined[1][element]))

    def clamp_slopes(self, one: Complex, other: Complex) -> Complex:
        """As `Plant.clamp_slopes`: E I one'' other'' / 2 beside each end that is not the bar's.

        The moment E I w'' is continuous there, and where the bar becomes rigid it does no more work; half of what a
        clamp grows by is at either end. Right to 3 %, as the curvature of an element is.
        """
        bar, out = self.device.bar, super().clamp_slopes(one, other)
        for column, actuator in enumerate(self.device.actuators):
            for end_m, is_start in zip(actuator.clamped_m(bar.length_m), (True, False), strict=True):
                node = int(np.abs(self.node_m - end_m).argmin())
                if not actuator.clamp_m or node in (0, len(self.node_m) - 1):
                    continue
                e = node - is_start
                a = self.node_m[e + 1] - self.node_m[e]
                second = np.array([6.0, 2 * a, -6.0, 4 * a] if is_start else [-6.0, -4 * a, 6.0, -2 * a]) / a**2
                dof, weight = self.element_dof[e], second @ self._joined[1][e]
                out[:, column] += (one[:, dof] @ weight) * (other[:, dof] @ weight) / 2
        return bar.youngs_modulus_pa * bar.width_m * bar.thickness_m**3 / 12 * out

    def at(self, points_m: Points) -> Array:
        """The functions of the elements at points (point,): (point, degree of freedom)."""
        sampler, rows = self.sampler(points_m), np.zeros((len(points_m), self.size))
        np.put_along_axis(rows, sampler.dof, sampler.weight, axis=1)
        return rows

    def mean_products(self, start_m: complex, stop_m: complex) -> Array:
        """Integral of f_k f_l over the elements between two nodes: (degree of freedom, degree of freedom), m."""
        middle_m, out = (self.node_m[:-1] + self.node_m[1:]) / 2, np.zeros((self.size, self.size))
        for e in np.flatnonzero((middle_m > start_m.real) & (middle_m < stop_m.real)):
            out[np.ix_(self.element_dof[e], self.element_dof[e])] += self.element_integral[e]
        return out

    @property
    def bending(self) -> Array:
        """K of a bar without its actuators (degree of freedom, degree of freedom)."""
        return dense(self.K)

    def _loaded(self, position_m: Sequence[complex], fingers: Sequence[Finger]) -> Self:
        """The plant with these fingers at these points."""
        K, C, M = self.K.copy(), self.C.copy(), self.M.copy()
        sampler = self.sampler(np.asarray(position_m, dtype=np.float64))
        for dof, weight, one in zip(sampler.dof[:, 0].tolist(), sampler.weight, fingers, strict=True):
            outer = np.outer(weight, weight)
            _add(K, dof, one.stiffness_n_per_m * outer)
            _add(C, dof, one.damping_n_s_per_m * outer)
            _add(M, dof, one.mass_kg * outer)
        return replace(self, K=K, C=C, M=M)

    def through(self, position_m: Points) -> Array:
        """Deflections and slopes of natural splines through the points, straight beyond the outermost ones."""
        from scipy.interpolate import CubicSpline  # only who has measured responses waits for its import

        place_m = position_m.real
        spline = CubicSpline(place_m, np.eye(len(place_m)), bc_type="natural")
        body_m = self.node_m[_bodies(self.device, self.node_m)[1] == 0.0]
        inside_m = np.clip(body_m, place_m[0], place_m[-1])
        slope = spline(inside_m, 1)
        out = np.empty((self.size, len(place_m)))
        out[0::2] = spline(inside_m) + (body_m - inside_m)[:, None] * slope
        out[1::2] = slope
        return out

    @property
    def resolution(self) -> dict[str, int | float]:
        """Number of elements, and the longest."""
        length_m = np.diff(self.node_m)
        return {"mesh_elements": len(length_m), "mesh_longest_element_m": float(length_m.max())}

    def dense(self) -> tuple[Array, Array, Array]:
        """K, C and M (degree of freedom, degree of freedom)."""
        return dense(self.K), dense(self.C), dense(self.M)

    def solve(self, omega: Array, loads: Sampler, spring: Array, damper: Array) -> Complex:
        """Displacement (frequency, load, degree of freedom), by elimination within the band."""
        from precompute.model.band_solver import solve_banded  # it compiles a kernel, which known modes do not need

        out = np.zeros((len(omega), len(loads.dof), self.size), dtype=np.complex128)
        first, weight = np.ascontiguousarray(loads.dof[:, 0]), np.ascontiguousarray(loads.weight)
        solve_banded(self.K, self.C, self.M, np.ascontiguousarray(omega), first, weight, spring, damper, out)
        return out

    def gram(self, field: Complex) -> Complex:
        """Integrals (frequency, zone + 1, column, column) of conj(v_a) v_b, exact over each element."""
        from precompute.model.gram import fill_gram

        frequencies, columns, _ = field.shape
        out = np.zeros((frequencies, len(self.device.zones) + 1, columns, columns), dtype=np.complex128)
        fill_gram(np.ascontiguousarray(field), self._joined[0], self.element_integral, self.element_zone, out)
        return out


def build_mesh(device: Device) -> Array:
    """Nodes (node,) in metres: one at every actuator, end of a clamp and zone edge; elements as short as asked."""
    length_m = device.bar.length_m
    forced = [actuator.position_m.real for actuator in device.actuators]
    forced += [end_m for actuator in device.actuators for end_m in actuator.clamped_m(length_m)]
    forced += [edge.real for zone in device.zones for edge in (zone.start_m, zone.stop_m)]
    edges = [0.0, length_m]
    for place in forced:
        if place < length_m and min(abs(place - edge) for edge in edges) > _SNAP * length_m:
            edges.append(place)
    edges.sort()
    pieces = [
        np.linspace(start, stop, int(np.ceil((stop - start) / device.bar.largest_element_m - 1e-9)), endpoint=False)
        for start, stop in itertools.pairwise(edges)
    ]
    return np.append(np.concatenate(pieces), length_m)


def _bodies(device: Device, node_m: Array) -> tuple[Integers, Array]:
    """The body (node,) that each node moves with, counted along the bar, and its distance from the body's own place, m.

    The nodes of a clamp are one body, whose place is the actuator's; every other node is a body of its own.
    """
    own, slack_m = np.arange(len(node_m)), _SNAP * device.bar.length_m * (1 + 1e-9)
    for actuator in device.actuators if any(each.clamp_m for each in device.actuators) else ():
        start_m, stop_m = actuator.clamped_m(device.bar.length_m)
        if stop_m - start_m > 2 * slack_m:
            held = (node_m >= start_m - slack_m) & (node_m <= stop_m + slack_m)
            own[held] = np.abs(node_m - actuator.position_m).argmin()
    return np.unique(own, return_inverse=True)[1], node_m - node_m[own]


def _join(device: Device, node_m: Array) -> tuple[Integers, Array]:
    """Elements by what they move with: first of four degrees of freedom (element,), and their ends by these.

    The ends (element, 4, 4): deflection and slope at either end, for each of the four degrees of freedom.
    """
    body, arm_m = _bodies(device, node_m)
    first = np.minimum(2 * body[:-1], 2 * body[-1] - 2)
    element, ends = np.arange(len(first)), np.zeros((len(first), 4, 4))
    for end in (0, 1):
        at = slice(end, len(first) + end)
        column = 2 * body[at] - first
        ends[element, 2 * end, column] = ends[element, 2 * end + 1, column + 1] = 1.0
        ends[element, 2 * end, column + 1] = arm_m[at]
    return first, ends


def _moved(matrix: Array, ends: Array) -> Array:
    """Matrices (element, 4, 4) over deflection and slope at the ends of elements, by what these move with."""
    return np.asarray(ends.swapaxes(-1, -2) @ matrix @ ends)


def assemble_bar(device: Device) -> BarPlant:
    """The plant of the untouched bar: the mesh, and its elements and actuators assembled.

    Raises DeviceError where an actuator is inertial: its moving mass does not fit into the band.
    """
    _check_grounded(device)
    return add_actuators(device, *_free_bar(device))


def _check_grounded(device: Device) -> None:
    for actuator in device.actuators:
        if actuator.is_inertial:
            raise DeviceError(
                f"{device.name}: {actuator.name} is inertial; measurements and calibrations are of grounded actuators "
                "only: take its values from its data sheet"
            )


def _free_bar(device: Device) -> tuple[Array, Array, Array]:
    """The mesh of a bar without actuators; its K and M."""
    bar, node_m = device.bar, build_mesh(device)
    first, ends = _join(device, node_m)
    bends, size = np.diff(_bodies(device, node_m)[0]) > 0, int(first[-1]) + 4
    K, M = np.zeros((BANDWIDTH + 1, size)), np.zeros((BANDWIDTH + 1, size))
    bending_stiffness = bar.youngs_modulus_pa * bar.width_m * bar.thickness_m**3 / 12
    mass_per_length = bar.density_kg_per_m3 * bar.width_m * bar.thickness_m
    for dof, end, bent, length_m in zip(first.tolist(), ends, bends, np.diff(node_m), strict=True):
        _add(K, dof, bent * _moved(stiffness_matrix(bending_stiffness, length_m), end))
        _add(M, dof, _moved(mass_per_length * shape_integral(length_m), end))
    return node_m, K, M


def assemble(device: Device) -> Plant:
    """The plant of the untouched surface of a device."""
    from precompute.model.modal_plant import assemble_modes
    from precompute.model.plate import assemble_plate

    if not isinstance(device.surface, Bar):
        return assemble_plate(device)
    if not any(actuator.is_inertial for actuator in device.actuators):
        return assemble_bar(device)
    node_m, K, M = _free_bar(device)
    return assemble_modes(device, BarPlant(device, node_m, K, np.zeros_like(K), M), dense(K), dense(M))


@lru_cache(maxsize=8)
def free_surface(device: Device) -> FreeSurface:
    """The surface of a device without its actuators, kept for fits. Raises DeviceError for inertial ones on bars."""
    from precompute.model.plate import FreePlate

    return FreeBar(device) if isinstance(device.surface, Bar) else FreePlate(device)


class FreeBar(FreeSurface):
    """A bar without its actuators: K and M (upper bands) scale with Young's modulus and the density."""

    def __init__(self, device: Device) -> None:
        _check_grounded(device)
        self._was = device

    def plant(self, device: Device) -> BarPlant:
        """The plant of a device whose bar has the same lengths."""
        node_m, K, M = self._of_clamps(device)
        K = K * (device.bar.youngs_modulus_pa / self._was.bar.youngs_modulus_pa)
        M = M * (device.bar.density_kg_per_m3 / self._was.bar.density_kg_per_m3)
        return add_actuators(device, node_m, K, M)

    def _of_clamps(self, device: Device) -> tuple[Array, Array, Array]:
        return self._clamped(*(actuator.clamp_m for actuator in device.actuators))

    @lru_cache(maxsize=4)  # noqa: B019  # of the few that `free_surface` keeps
    def _clamped(self, *clamp_m: float) -> tuple[Array, Array, Array]:
        """Mesh, K and M with other clamps (actuator,)."""
        actuators = zip(self._was.actuators, clamp_m, strict=True)
        return _free_bar(replace(self._was, actuators=tuple(replace(each, clamp_m=own) for each, own in actuators)))

    def strain(self, device: Device, one: Complex, other: Complex) -> dict[str, Complex]:
        """Derivative of one^T K other (row,) by Young's modulus."""
        work = (one * _times(self._of_clamps(device)[1], other)).sum(axis=1)
        return {"youngs_modulus": work / self._was.bar.youngs_modulus_pa}

    def motion(self, device: Device, one: Complex, other: Complex) -> Complex:
        """Derivative of one^T M other (row,) by the density."""
        return (one * _times(self._of_clamps(device)[2], other)).sum(axis=1) / self._was.bar.density_kg_per_m3


def add_actuators(device: Device, node_m: Array, K: Array, M: Array) -> BarPlant:
    """The plant of a bar K, M (upper bands, changed in place) with its actuators; C = C_A + sigma M + eta K.

    Paper eqs. (2), (3). M and K there are the bar's own, without bolts and springs, or with `damping_of` "assembly"
    the whole plant's. The paper can be read either way; docs/theory.md (damping) says what speaks for each.
    """
    bar, plant = device.bar, BarPlant(device, node_m, K, np.zeros_like(K), M)
    of_bar = bar.mass_damping_per_s * M + bar.stiffness_damping_s * K
    for actuator, dof in zip(device.actuators, plant.actuator_dof, strict=True):
        K[-1, dof] += actuator.stiffness_n_per_m
        plant.C[-1, dof] += actuator.damping_n_s_per_m
        M[-1, dof] += actuator.mass_kg
    plant.C[:] += of_bar if bar.damping_of == "bar" else bar.mass_damping_per_s * M + bar.stiffness_damping_s * K
    return plant


def dense(band: Array) -> Array:
    """The full symmetric matrix of an upper band."""
    size = band.shape[1]
    full = np.zeros((size, size))
    for k in range(BANDWIDTH + 1):
        diagonal = band[BANDWIDTH - k, k:]
        full[np.arange(size - k), np.arange(k, size)] = diagonal
        full[np.arange(k, size), np.arange(size - k)] = diagonal
    return full


def _add(band: Array, first: int, block: Array) -> None:
    """Add a symmetric 4 x 4 element block at degree of freedom `first`."""
    for row in range(4):
        for column in range(row, 4):
            band[BANDWIDTH + row - column, first + column] += block[row, column]


def _times(band: Array, field: Complex) -> Complex:
    """A symmetric matrix in upper band form times fields (..., degree of freedom)."""
    out: Complex = band[-1] * field
    for k in range(1, BANDWIDTH + 1):
        diagonal = band[BANDWIDTH - k, k:]
        out[..., :-k] += diagonal * field[..., k:]
        out[..., k:] += diagonal * field[..., :-k]
    return out


def stiffness_matrix(bending_stiffness_n_m2: float, length_m: float) -> Array:
    """Shape (4, 4): integral of EI N'' N''^T, degrees of freedom (y0, slope0, y1, slope1); paper eq. (1)."""
    a = length_m
    matrix = [
        [12.0, 6 * a, -12.0, 6 * a],
        [6 * a, 4 * a * a, -6 * a, 2 * a * a],
        [-12.0, -6 * a, 12.0, -6 * a],
        [6 * a, 2 * a * a, -6 * a, 4 * a * a],
    ]
    return bending_stiffness_n_m2 / a**3 * np.array(matrix)


def shape_integral(length_m: float) -> Array:
    """Shape (4, 4), in metres: integral of N N^T over the element; times mass per length it is the mass matrix."""
    a = length_m
    matrix = [
        [156.0, 22 * a, 54.0, -13 * a],
        [22 * a, 4 * a * a, 13 * a, -3 * a * a],
        [54.0, 13 * a, 156.0, -22 * a],
        [-13 * a, -3 * a * a, -22 * a, 4 * a * a],
    ]
    return a / 420 * np.array(matrix)


def shape_functions(xi: Array, length_m: Array) -> Array:
    """Shape (..., 4): N at `xi` = 0..1 along elements of `length_m`."""
    at_start = 1 - 3 * xi**2 + 2 * xi**3, length_m * (xi - 2 * xi**2 + xi**3)
    return np.stack([*at_start, 3 * xi**2 - 2 * xi**3, length_m * (xi**3 - xi**2)], axis=-1)
