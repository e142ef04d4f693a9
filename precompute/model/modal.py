"""Damped modes of the plant: poles and mode shapes of the state space, with the coupling by dampers kept.

How many modes are kept follows from the band. With m of them the receptances between actuators and the fingers of every
zone, all fingers on the bar, are compared with those of the finite elements: the basis has the fewest modes with which,
and with any more, they differ by less than 0.01 dB of their greatest value, over the sweep and over the band of clicks.
A soft, long bar needs many (500 x 0.8 mm of acrylic: 84), a short, stiff one few (100 x 3 mm of steel: 8).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from base.arrays import Array, Complex, Points, even_points
from engine.device import Device, Finger
from engine.device.surface_description import CLICKS_TOP_HZ
from precompute.model.assembly import assemble
from precompute.model.plant import Plant

CONVERGED = 10 ** (0.01 / 20) - 1  # tolerated error of a receptance, as a fraction of its greatest value: 0.01 dB
_FIRST_MODES = 32  # shipped bars need 20; doubled until enough, so it costs time only
_STEP_OF_MODES = 4
_STEPS_OF_BAND = 64  # truncation errs smoothly over frequency: this many steps of a band find its greatest error


@dataclass(frozen=True)
class Basis:
    """Undamped modes of the untouched bar, mass-normalised: `shape` (degree of freedom, mode) spans every motion."""

    plant: Plant
    shape: Array
    square_omega: Array
    damping: Array

    def lowest(self, modes: int) -> "Basis":
        """The basis of the lowest `modes` modes alone."""
        kept = slice(modes)
        shape, damping = np.ascontiguousarray(self.shape[:, kept]), np.ascontiguousarray(self.damping[kept, kept])
        return Basis(self.plant, shape, self.square_omega[kept], damping)

    def at(self, position_m: Array | Complex) -> Array:
        """Mode shapes at positions: (point, mode)."""
        return self.plant.sampler(position_m).shapes(self.shape)

    @property
    def at_actuators(self) -> Array:
        """Mode shapes at the actuators, relative to a moving mass if there is one: (actuator, mode)."""
        return self.plant.actuators.shapes(self.shape)


@dataclass(frozen=True)
class ModalModel:
    """State (q, q') = vector z with z' = pole z + spring u + damper u', u (actuator,) as fractions of full scale.

    pole (state,); vector (2 mode, state) and its inverse; spring, damper (state, actuator): what a base displacement
    and its rate put in; push (mode, 2, actuator): the same as mode accelerations.
    """

    basis: Basis
    pole: Complex
    vector: Complex
    inverse: Complex
    spring: Complex
    damper: Complex
    push: Array


def compute_basis(plant: Plant, modes: int | None = None) -> Basis:
    """The lowest undamped modes with their damping; by default as many as the band needs (CONVERGED)."""
    if modes is not None:
        return _solve_modes(plant, min(modes, plant.size))
    sweep, count = plant.device.sweep, _FIRST_MODES
    bands_hz = (sweep.start_hz, sweep.stop_hz), (sweep.start_hz, max(sweep.stop_hz, CLICKS_TOP_HZ))
    while True:
        basis = _solve_modes(plant, min(count, plant.size))
        enough = [count_modes(basis, CONVERGED, band_hz) for band_hz in bands_hz]
        if max(enough) <= len(basis.square_omega):
            return basis.lowest(max(enough))
        if count >= plant.size:
            return basis
        count *= 2


def count_modes(basis: Basis, tolerance: float, band_hz: tuple[float, float]) -> int:
    """The fewest modes of the basis with which, and with any more of them, receptances are within `tolerance`.

    One more than the basis has where not even all are enough. `tolerance` is a fraction of each receptance's greatest
    value in the band; the reference is the finite-element solution.
    """
    error = truncation_errors(basis, np.linspace(*band_hz, _STEPS_OF_BAND + 1))
    short = np.flatnonzero(error > tolerance)
    steps = int(short[-1]) + 2 if len(short) else 1
    return _STEP_OF_MODES * steps if steps <= len(error) else len(basis.square_omega) + 1


def truncation_errors(basis: Basis, frequency_hz: Array) -> Array:
    """Greatest error of the receptances with 4, 8, 12 ... modes of the basis, as fractions of their greatest values.

    Accelerations at a finger in the middle of every zone per unit force of each actuator, all fingers on the bar.
    """
    # It compiles kernels, which known modes do not need.
    from precompute.model.response import blocked_force, solve_response

    device, omega = basis.plant.device, 2 * np.pi * frequency_hz
    plant = assemble(device) if basis.plant.is_measured else basis.plant  # fingers join no measured responses
    middle_m = np.array([zone.middle_m for zone in device.zones])
    count, finger = len(device.actuators), device.finger
    loaded = solve_response(plant.with_fingers(middle_m.tolist(), finger), frequency_hz)
    force = blocked_force(device.actuators, frequency_hz)
    exact = plant.sampler(middle_m).sample(loaded.displacement_m) / force[..., None]
    shape = np.concatenate([basis.at_actuators, basis.at(middle_m)])
    error, greatest = np.zeros((len(basis.square_omega) // _STEP_OF_MODES, *exact.shape[1:])), np.zeros(exact.shape[1:])
    for w, reference in zip(omega, exact, strict=True):
        touch = finger.stiffness_n_per_m + 1j * w * finger.damping_n_s_per_m - w**2 * finger.mass_kg
        impedance = np.concatenate([1j * w * mount_dampers(basis), np.full(len(middle_m), touch)])
        free = _partial_receptances(basis, shape, 1j * w)
        attached = np.linalg.solve(np.eye(len(shape)) + free * impedance, free)  # (1 + G Z)^-1 G
        change = attached[:, count:, :count].swapaxes(-1, -2) - reference
        error, greatest = np.maximum(error, w**2 * abs(change)), np.maximum(greatest, w**2 * abs(reference))
    return (error / greatest).max(axis=(1, 2))


def _partial_receptances(basis: Basis, shape: Array, s: complex) -> Complex:
    """Receptances (step, place, place) with 4, 8, 12 ... modes, of the bar without its actuators' dampers."""
    bar, places, steps = basis.plant.device.surface, len(shape), len(basis.square_omega) // _STEP_OF_MODES
    kept = steps * _STEP_OF_MODES
    square, rows = basis.square_omega[:kept], shape[:, :kept].T
    modal = 1 / (s**2 + (bar.mass_damping_per_s + bar.stiffness_damping_s * square) * s + square)
    terms = modal[:, None, None] * rows[:, :, None] * rows[:, None, :]
    sums = terms.reshape(steps, _STEP_OF_MODES, places, places).sum(axis=1).cumsum(axis=0)
    return np.asarray(sums, dtype=np.complex128)


def mount_dampers(basis: Basis) -> Array:
    """Shape (actuator,), N s/m: what the actuators damp beyond sigma + eta omega^2 of the modes.

    The modes are those of the bar with its actuators, so where only the bar is damped, too much is in them.
    """
    bar, actuators = basis.plant.device.surface, basis.plant.device.actuators
    own = np.array([actuator.damping_n_s_per_m for actuator in actuators])
    if bar.damping_of == "assembly":
        return own
    stiffness, mass = np.array([(each.stiffness_n_per_m, each.grounded_mass_kg) for each in actuators]).T
    return own - bar.stiffness_damping_s * stiffness - bar.mass_damping_per_s * mass


def _solve_modes(plant: Plant, count: int) -> Basis:
    K, C, M = plant.dense()
    square, shape = scipy.linalg.eigh(K, M, subset_by_index=(0, count - 1))
    # Not below 0, where rounding puts the free turning about a single actuator.
    return Basis(plant, shape, np.maximum(square, 0.0), shape.T @ C @ shape)


def compute_modal_model(basis: Basis, fingers: Sequence[tuple[complex, Finger]] = ()) -> ModalModel:
    """Damped modes with fingers (position in metres, finger) added to the untouched bar's basis."""
    count = len(basis.square_omega)
    M, K, C = np.eye(count), np.diag(basis.square_omega), basis.damping.copy()
    rows = basis.at(np.array([position_m for position_m, _ in fingers]))
    for row, (_, finger) in zip(rows, fingers, strict=True):
        outer = np.outer(row, row)
        M += finger.mass_kg * outer
        K += finger.stiffness_n_per_m * outer
        C += finger.damping_n_s_per_m * outer
    system = np.block([[np.zeros((count, count)), np.eye(count)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    pole, vector = np.linalg.eig(system)
    pole = np.minimum(pole.real, 0.0) + 1j * pole.imag  # passive: growth is rounding
    inverse = np.linalg.inv(vector)
    push = np.asarray(np.linalg.solve(M, _forces(basis).reshape(count, -1)), dtype=np.float64).reshape(count, 2, -1)
    spring, damper = (np.asarray(inverse[:, count:] @ push[:, i], dtype=np.complex128) for i in (0, 1))
    return ModalModel(basis, pole, vector, inverse, spring, damper, push)


def _forces(basis: Basis) -> Array:
    """Modal force per unit base displacement and per unit rate: (mode, 2, actuator)."""
    actuators = basis.plant.device.actuators
    drive = basis.at_actuators.T
    spring, damper = np.array([(a.spring_force_n, a.damper_force_n_s) for a in actuators]).T
    return np.stack([drive * spring, drive * damper], axis=1)


POINTS, _ACROSS = 201, 61  # of shapes along a surface, 2 mm apart on 400 mm for nodes; and across a plate
_STILL = 1e-6  # share of the natural frequency below which a pole does not oscillate: it is overdamped, or turns freely


@dataclass(frozen=True, eq=False)
class Mode:
    """One damped mode: amplitudes fall to 1/e in decay_s. shape (point,): greatest displacement 1, at its peak in time.

    Of the pole p: frequency_hz = |p| / 2 pi, damping_ratio = -Re p / |p|, decay_s = -1 / Re p.
    """

    frequency_hz: float
    damping_ratio: float
    decay_s: float
    shape: Array


def seen_points(device: Device) -> Points:
    """Evenly spaced points (point,) that shapes are seen at: along a bar, on a plate rows of POINTS."""
    corner_m = device.surface.corner_m
    return np.asarray(even_points(0 * corner_m, corner_m, POINTS, _ACROSS))


def compute_modes(
    device: Device, position_m: Points, up_to_hz: float, finger_m: Sequence[complex] = ()
) -> tuple[Mode, ...]:
    """Modes up to a frequency, rising, with a finger at each of `finger_m`; shapes are those at position_m (point,)."""
    basis = compute_basis(assemble(device))
    model = compute_modal_model(basis, [(at_m, device.finger) for at_m in finger_m])
    along, count = basis.at(position_m), len(basis.square_omega)
    found = []
    for pole, vector in zip(model.pole, model.vector[:count].T, strict=True):
        size = abs(pole)
        if pole.imag <= _STILL * size or size > 2 * np.pi * up_to_hz or size == 0.0:
            continue
        field = along @ vector
        peak = field[np.argmax(np.abs(field))]
        decay_s = -1 / pole.real if pole.real else np.inf
        found.append(Mode(size / (2 * np.pi), -pole.real / size, float(decay_s), (field / peak).real))
    return tuple(sorted(found, key=lambda mode: mode.frequency_hz))
