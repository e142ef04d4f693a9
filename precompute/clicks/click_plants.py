"""Transfer functions of sampled plants, from each actuator to the weighted acceleration under every finger.

Theory of operation
-------------------
A click is optimised over, trimmed on and evaluated with a thousand sampled plants; from one placement to the next only
the fingers differ. What does not depend on fingers is computed once for a device:

1. The modes of the nominal bar, some more than are kept, are a Ritz basis: every sampled bar, a few per cent stiffer
   or heavier, is a small eigenproblem in it. Its damping is diagonal but for one rank-one term for each actuator.
2. The receptance between two places is a sum over modes,
   G0(p, q, s) = sum_m phi_pm phi_qm / (s^2 + (sigma + eta omega_m^2) s + omega_m^2).
   Modes far above the band give a compliance that hardly depends on s: they are summed once, as one mode more.

A placement then costs the sums over modes between its fingers and the actuators, and one rank-one update for each
damper and each finger z(s) = k + c s + m s^2 (Sherman and Morrison).
Acceleration, the straight lines that the device draws between samples, and the threshold filter are one factor s; the
transfer function of an actuator is another, for those that have one.

Everything is evaluated on the damped lines of `precompute.model.damped_lines`, in single precision. A test compares
the courses with those of the time-domain plant.
"""

from copy import copy
from functools import lru_cache, partial

import numpy as np
import scipy.linalg

from base.arrays import Array, Complex, Complex32, Integers, Points, Single
from base.compiled import njit
from base.points import clip_points
from engine.device import Device, Threshold
from precompute.model.assembly import assemble
from precompute.model.damped_lines import DampedLines
from precompute.model.modal import compute_basis
from precompute.model.plant import Plant, moved_masses
from precompute.model.transfers import threshold_filter, transfers_at
from precompute.sampling.plants import Fingers, Scenarios, sample_scenarios

_STATIC_MODES = 12  # beyond those that are kept, in the Ritz basis of the sampled bars: their compliance
_CONVERGED = 1e-3  # change by the omitted modes that is tolerated, as a fraction of the greatest response: 0.01 dB
_MOST_MODES = 128
_STEP_OF_MODES = 2
_FEWEST_MODES = 4  # a plate that floats has three modes without stiffness, which is no compliance
_FILTER_OVERSAMPLING = 2  # the filter is designed at this multiple of the rate, and right up to its Nyquist


class SampledPlants:
    """Transfer functions of all scenarios of one device, with fingers at any places.

    `modes` is how many modes move: with them the transfer functions are converged to 0.01 dB of their greatest value
    (see `count_modes`).
    """

    def __init__(self, scenarios: Scenarios, lines: DampedLines, modes: int | None = None) -> None:
        self.scenarios, self.lines = scenarios, lines
        self.modes = modes or count_modes(scenarios.device, lines)
        self._shapes_of, square_omega = _sampled_modes(scenarios, self.modes)
        bars = [calibrated.surface for calibrated in scenarios.calibrated]
        mass_damping = np.array([bar.mass_damping_per_s for bar in bars])
        stiffness_damping = np.array([bar.stiffness_damping_s for bar in bars])
        self._compliance = (1 / square_omega[:, self.modes :]).astype(np.float32)
        square_omega = np.ascontiguousarray(square_omega[:, : self.modes])
        self._square_omega = square_omega
        self._own_damping = mass_damping[:, None] + stiffness_damping[:, None] * square_omega
        sampled = [scenarios.device_of(index).actuators for index in range(len(scenarios))]
        stiffness, damping, mass, spring, damper = (
            np.array([[getattr(actuator, key) for actuator in each] for each in sampled])
            for key in (
                "stiffness_n_per_m",
                "damping_n_s_per_m",
                "grounded_mass_kg",
                "spring_force_n",
                "damper_force_n_s",
            )
        )
        self._actuator = np.empty((*damping.shape, square_omega.shape[1] + self._compliance.shape[1]), np.float32)
        for plant, members, nodal in self._shapes_of:
            own = plant.actuators
            self._actuator[members] = [own.shapes(each) for each in nodal]
        # The modes damp as sigma + eta omega^2; actuators' springs and masses have a part in that or not.
        in_modes = stiffness_damping[:, None] * stiffness + mass_damping[:, None] * mass
        self._damper = np.zeros((*damping.shape, 3), np.float32)
        self._damper[..., 1] = damping - in_modes * np.array([[bar.damping_of == "bar"] for bar in bars])
        self._force = np.stack([spring, damper], axis=2).astype(np.float32)
        self._take_lines(lines.s_per_s, output_factor(lines, scenarios.device.threshold))

    def _take_lines(self, s_per_s: Complex, factor: Complex) -> None:
        self._s_per_s, self._factor = s_per_s, factor
        self._pole = np.empty((len(self.scenarios), self.modes + 1, 2, len(s_per_s)), np.float32)
        self._pole[:, -1, 0], self._pole[:, -1, 1] = 1.0, 0.0  # of the static modes
        _fill_poles(s_per_s.real.copy(), s_per_s.imag.copy(), self._square_omega, self._own_damping, self._pole)
        transfers, channels = transfers_at(self.scenarios.device.actuators, s_per_s), self.scenarios.channels(s_per_s)
        self._transfers = None if transfers is None else transfers.T.astype(np.complex64)
        self._channels = None if channels is None else channels.astype(np.complex64)

    def at_tones(self, hz: Array) -> "SampledPlants":
        """The same plants, whose lines (line,) are lasting tones of these frequencies."""
        s_per_s, tones = (2j * np.pi * hz).astype(np.complex128), copy(self)
        tones._take_lines(s_per_s, s_per_s**2 / self.scenarios.device.threshold.peak_m_per_s2(hz))
        return tones

    def transfer(self, fingers: Fingers) -> Complex32:
        """Transfer functions (scenario, finger, actuator, line) with these fingers on the bar of the first scenarios.

        From commands, as fractions of full scale, to the weighted acceleration under each finger: 1 is at the detection
        threshold.
        """
        count, touches = fingers.position_m.shape
        s = self._s_per_s.astype(np.complex64)
        out = np.empty((count, touches, self._actuator.shape[1], len(s)), np.complex64)
        impedance = np.stack([fingers.stiffness_n_per_m, fingers.damping_n_s_per_m, fingers.mass_kg], axis=2)
        _fill_transfer(
            self._pole,
            self._compliance,
            np.concatenate([self._actuator[:count], self._shapes(fingers.position_m)], axis=1),
            s,
            np.concatenate([self._damper[:count], impedance.astype(np.float32)], axis=1),
            self._force,
            self._factor.astype(np.complex64),
            out,
        )
        if self._transfers is not None:
            out *= self._transfers
        if self._channels is not None:
            out *= self._channels[:count, None]
        return out

    def _shapes(self, position_m: Points) -> Single:
        """Mode shapes (scenario, place, mode) of the first sampled bars at positions (scenario, place)."""
        shape = np.empty((*position_m.shape, self._pole.shape[1] - 1 + self._compliance.shape[1]), np.float32)
        for plant, every, nodal in self._shapes_of:
            members = every[: np.searchsorted(every, len(shape))]
            at_m = clip_points(position_m[members].ravel(), plant.device.surface.corner_m)
            sampler = plant.sampler(at_m)
            row = np.repeat(np.arange(len(members)), position_m.shape[1])
            ends = nodal[row[:, None], sampler.dof]
            weight = sampler.weight.astype(np.float32)
            shape[members] = np.einsum("pkm,pk->pm", ends, weight).reshape(len(members), *shape.shape[1:])
        return shape


def count_modes(device: Device, lines: DampedLines) -> int:
    """Number of modes with which the transfer functions are converged to 0.01 dB of their greatest value.

    It is found on the nominal bar with a finger in every zone.
    """
    nominal = sample_scenarios(device, 0, 0)
    most = min(_MOST_MODES, assemble(device).size - _STATIC_MODES)
    plants = SampledPlants(nominal, lines, most)
    everywhere = nominal.place([(zone.start_m + zone.stop_m) / 2 for zone in device.zones])
    converged = plants.transfer(everywhere)
    greatest = np.abs(converged).max(axis=(0, 2, 3), keepdims=True)
    for modes in range(_FEWEST_MODES, most, _STEP_OF_MODES):
        change = np.abs(SampledPlants(nominal, lines, modes).transfer(everywhere) - converged)
        if (change <= _CONVERGED * greatest).all():
            return modes
    return most


@lru_cache(maxsize=4)
def output_factor(lines: DampedLines, threshold: Threshold) -> Complex:
    """Factor (line,) from displacement to weighted acceleration: s^2, the threshold filter, linear interpolation.

    A sample at full scale is a triangle of two sample periods: (sinh(x) / x)^2 with x = s T / 2.
    """
    s = lines.s_per_s
    half = s / (2 * lines.rate_hz)
    return s**2 * (np.sinh(half) / half) ** 2 * weighting(lines, threshold)


def weighting(lines: DampedLines, threshold: Threshold) -> Complex:
    """Factor (line,) from acceleration to weighted acceleration: the threshold filter."""
    rate_hz = _FILTER_OVERSAMPLING * lines.rate_hz
    taps = threshold_filter(threshold, rate_hz)
    return np.exp(-np.outer(lines.s_per_s, np.arange(len(taps)) / rate_hz)) @ taps


def _sampled_modes(scenarios: Scenarios, modes: int) -> tuple[list[tuple[Plant, Integers, Single]], Array]:
    """Modes of every sampled bar as combinations of the modes of a bar of the same dimensions.

    Returns the plants of each dimensions, with the indices of their scenarios and the shapes (scenario, degree of
    freedom, mode) of all modes; and square_omega (scenario, mode), in (rad/s)^2.
    """
    groups: dict[tuple[complex, ...], list[int]] = {}
    for index, device in enumerate(scenarios.calibrated):
        places_m = (device.surface.corner_m, *(m for each in device.actuators for m in (each.position_m, each.clamp_m)))
        groups.setdefault(places_m, []).append(index)
    square_omega = np.empty((len(scenarios), modes + _STATIC_MODES))
    shapes = []
    for members in groups.values():
        base = scenarios.calibrated[members[0]]
        plant = assemble(base)
        basis = compute_basis(plant, modes + _STATIC_MODES)
        attached = partial(_attached, basis.at_actuators, plant.masses.shapes(basis.shape))
        # In the base's modes the whole is diagonal; the bar alone is what the springs and masses of actuators leave.
        stiffness, mass = attached(base)
        bar_stiffness, bar_mass = np.diag(basis.square_omega) - stiffness, np.eye(len(mass)) - mass
        nodal = np.empty((len(members), *basis.shape.shape), np.float32)
        for row, index in enumerate(members):
            device = scenarios.device_of(index)
            stiffness, mass = attached(device)
            stiffness += _bending(device) / _bending(base) * bar_stiffness
            mass += _mass(device) / _mass(base) * bar_mass
            # Bending and mass scale the bar; its modes with other actuators are combinations of those of the base.
            square, vector = scipy.linalg.eigh(stiffness, mass, check_finite=False, driver="gvd")
            square_omega[index] = np.maximum(square, 0.0)
            np.matmul(basis.shape, vector, out=nodal[row], casting="same_kind")
        shapes.append((plant, np.array(members), nodal))
    return shapes, square_omega


def _attached(springs: Array, masses: Array, device: Device) -> tuple[Array, Array]:
    """What actuators add to stiffness and mass (mode, mode); mode shapes at springs, and masses, (point, mode)."""
    stiffness = np.array([actuator.stiffness_n_per_m for actuator in device.actuators])
    return (springs.T * stiffness) @ springs, (masses.T * moved_masses(device.actuators)) @ masses


def _bending(device: Device) -> float:
    """What the bending stiffness of a surface is proportional to, whose sides and Poisson's ratio do not vary."""
    return device.surface.youngs_modulus_pa * device.surface.width_m * device.surface.thickness_m**3


def _mass(device: Device) -> float:
    """What its mass is proportional to."""
    return device.surface.density_kg_per_m3 * device.surface.width_m * device.surface.thickness_m


@njit(nogil=True, cache=True, error_model="numpy")
def _fill_poles(real: Array, imag: Array, square_omega: Array, damping: Array, pole: Single) -> None:
    """Fill pole (scenario, mode, 2, line) with 1 / (s^2 + c s + omega^2), s = real + j imag (line,).

    square_omega, damping (scenario, mode): omega^2 and c.
    """
    for i in range(len(square_omega)):
        for m in range(square_omega.shape[1]):
            square, c = square_omega[i, m], damping[i, m]
            for k in range(len(real)):
                a = real[k] * real[k] - imag[k] * imag[k] + c * real[k] + square
                b = imag[k] * (2 * real[k] + c)
                scale = 1 / (a * a + b * b)
                pole[i, m, 0, k], pole[i, m, 1, k] = a * scale, -b * scale


@njit(nogil=True, cache=True, fastmath=True, error_model="numpy")
def _fill_transfer(
    pole: Single,
    compliance: Single,
    shape: Single,
    s: Complex32,
    attached: Single,
    force: Single,
    factor: Complex32,
    out: Complex32,
) -> None:
    """Transfer functions (scenario, finger, actuator, line), scenario by scenario.

    pole (scenario, mode, 2, line), the last one that of the static modes; compliance (scenario, static mode). shape
    (scenario, place, mode): the actuators first, then the fingers; all modes. attached (scenario, place, 3): stiffness,
    damping, mass; force (scenario, actuator, 2). Real and imaginary parts are separate arrays along the lines, so that
    the loops over lines become vector instructions.
    """
    scenarios, fingers, actuators, count = out.shape
    places, moving, modes = shape.shape[1], pole.shape[1] - 1, pole.shape[1]
    pairs = (places * (places + 1) // 2 + 1) // 2 * 2
    real, imag = s.real.copy(), s.imag.copy()
    factor_real, factor_imag = factor.real.copy(), factor.imag.copy()
    weight, g = np.zeros((pairs, (modes + 3) // 4 * 4), np.float32), np.empty((pairs, 2, count), np.float32)
    column, space = np.empty((places, 2, count), np.float32), np.empty((4, count), np.float32)
    for i in range(scenarios):
        # Receptances of the bar with springs and masses: sums over modes, for all pairs of places as one product.
        for p in range(places):
            for q in range(p, places):
                static = np.float32(0.0)
                for m in range(compliance.shape[1]):
                    static += shape[i, p, moving + m] * shape[i, q, moving + m] * compliance[i, m]
                for m in range(moving):
                    weight[_pair(p, q, places), m] = shape[i, p, m] * shape[i, q, m]
                weight[_pair(p, q, places), moving] = static
        _fill_sums(weight, pole[i].reshape((modes, 2 * count)), g.reshape((pairs, 2 * count)))
        # One place after another, by the rank-one update: the dampers of the mounts first, then the fingers.
        for j in range(places):
            stiffness, damping, mass = attached[i, j]
            _attach(g, j, actuators, real, imag, stiffness, damping, mass, column, space)
        for f in range(fingers):
            for n in range(actuators):
                # Force of a base that moves by 1: spring and damper, then what makes it weighted acceleration.
                spring, rate = force[i, n]
                own = g[_pair(n, actuators + f, places)]
                for k in range(count):
                    a, b = spring + rate * real[k], rate * imag[k]
                    x, y = a * factor_real[k] - b * factor_imag[k], a * factor_imag[k] + b * factor_real[k]
                    real_part = x * own[0, k] - y * own[1, k]
                    out[i, f, n, k] = complex(real_part, x * own[1, k] + y * own[0, k])


@njit(fastmath=True, error_model="numpy", inline="always")
def _fill_sums(weight: Single, pole: Single, out: Single) -> None:
    """Fill out (pair, line) with weight (pair, mode) @ pole (mode, line): two pairs and four modes at a time.

    Pairs are even in number; weight has columns of 0 up to a multiple of four modes.
    """
    last = len(pole) - 1
    out[:] = np.float32(0.0)
    for p in range(0, len(out), 2):
        # Each line of the poles is read for two pairs at once: memory is what this waits for.
        sums, others = out[p], out[p + 1]
        for m in range(0, len(pole), 4):
            one, two, three, four = pole[m], pole[min(m + 1, last)], pole[min(m + 2, last)], pole[min(m + 3, last)]
            v, w = weight[p, m : m + 4], weight[p + 1, m : m + 4]
            for k in range(pole.shape[1]):
                sums[k] += v[0] * one[k] + v[1] * two[k] + v[2] * three[k] + v[3] * four[k]
                others[k] += w[0] * one[k] + w[1] * two[k] + w[2] * three[k] + w[3] * four[k]


@njit(error_model="numpy", inline="always")
def _pair(one: int, other: int, places: int) -> int:
    """Index of a pair of places in the upper triangle."""
    low, high = min(one, other), max(one, other)
    return low * places - low * (low - 1) // 2 + high - low


@njit(fastmath=True, error_model="numpy", inline="always")
def _attach(
    g: Single,
    j: int,
    actuators: int,
    real: Single,
    imag: Single,
    stiffness: np.float32,
    damping: np.float32,
    mass: np.float32,
    column: Single,
    space: Single,
) -> None:
    """Attach z = stiffness + damping s + mass s^2 at place j: G becomes G - G_j z / (1 + z G_jj) G_j^T.

    g (pair, 2, line). Only what is needed later is computed: between actuators and fingers, and with places after j.
    column (place, 2, line) and space (4, line) are overwritten.
    """
    places = len(column)
    own_real, own_imag, c, d, u, v = column[j, 0], column[j, 1], space[0], space[1], space[2], space[3]
    for p in range(places):  # loops: an assignment of slices takes seconds to compile
        at_p = g[_pair(p, j, places)]
        for part in range(2):
            for k in range(len(u)):
                column[p, part, k] = at_p[part, k]
    # u + j v = z / (1 + z G_jj)
    for k in range(len(u)):
        a = stiffness + damping * real[k] + mass * (real[k] * real[k] - imag[k] * imag[k])
        b = imag[k] * (damping + 2 * mass * real[k])
        x = 1 + a * own_real[k] - b * own_imag[k]
        y = a * own_imag[k] + b * own_real[k]
        scale = 1 / (x * x + y * y)
        u[k], v[k] = (a * x + b * y) * scale, (b * x - a * y) * scale
    for p in range(places):
        # c + j d = G_pj (u + j v)
        _multiply(column[p], u, v, c, d)
        for q in range(p, places):
            if q > j or (p < actuators and q >= actuators):
                _subtract_product(column[q], c, d, g[_pair(p, q, places)])


@njit(fastmath=True, error_model="numpy", inline="always")
def _multiply(x: Single, u: Single, v: Single, c: Single, d: Single) -> None:
    """Fill c + j d with x (2, line) times u + j v; one loop for each part, so that both become vector instructions."""
    real, imag = x[0], x[1]
    for k in range(len(u)):
        c[k] = real[k] * u[k] - imag[k] * v[k]
    for k in range(len(u)):
        d[k] = real[k] * v[k] + imag[k] * u[k]


@njit(fastmath=True, error_model="numpy", inline="always")
def _subtract_product(x: Single, c: Single, d: Single, out: Single) -> None:
    """Subtract x (2, line) times c + j d from out (2, line)."""
    real, imag, out_real, out_imag = x[0], x[1], out[0], out[1]
    for k in range(len(c)):
        out_real[k] -= real[k] * c[k] - imag[k] * d[k]
    for k in range(len(c)):
        out_imag[k] -= real[k] * d[k] + imag[k] * c[k]
