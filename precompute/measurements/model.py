"""Predicted accelerations of the rows of a measurement, and their derivatives by every fitted parameter.

Sensor and finger are attached to the surface at each row's own points by a low-rank update: fields are solved once for
each frequency, wherever the sensor roves. The derivatives need no further solve: the dynamic stiffness D is symmetric,
so the fields of unit forces at the attached points are the adjoint fields of the readings there. With seeded noise and
wrong readings, predictions of known parameters are simulated measurements.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from base.arrays import Array, Complex, Integers, Points
from engine.device import Device, Finger
from precompute.measurements.parameters import Parameter, with_values
from precompute.measurements.types import Kind, Measurements
from precompute.model.assembly import free_surface
from precompute.model.plant import FreeSurface, Plant
from precompute.model.response import solve_response
from precompute.model.transfers import transfers_at

_CHUNK = 64  # frequencies at a time: fields of 60 columns in 256 elements take 32 MB
_SENSOR, _FINGER = 0, 1
_TINY = 1e-300  # a node has a logarithm


@dataclass(frozen=True)
class Prediction:
    """Logarithm of the predicted readings, and its derivatives by the SI values of the parameters.

    log_acceleration (row,): its imaginary part is the phase of a response, 0 for a peak; by_parameter (row, parameter).
    """

    log_acceleration: Complex
    by_parameter: Complex


@dataclass(frozen=True)
class _Tones:
    """A tone for every frequency of every row: the row, the index of the frequency, and the drive (tone, actuator)."""

    frequency_hz: Array
    row: Integers
    frequency: Integers
    drive: Complex


@dataclass(frozen=True)
class _Loaded:
    """The loaded bar, with sensor and finger: its field under each tone, and under a unit force at the sensor.

    field, adjoint (tone, degree of freedom); at_place (tone, place, 2): both under the sensor and under the finger.
    """

    omega: Array
    field: Complex
    adjoint: Complex
    at_place: Complex


class MeasurementModel:
    """Predicts the rows of `measurements` for `device` with any values of `parameters`.

    The functions are those that tables are built on, without nodes at the sensor: a table fits what was measured.
    """

    def __init__(self, device: Device, measurements: Measurements, parameters: Sequence[Parameter]) -> None:
        self._device, self._parameters, self._kind = device, tuple(parameters), measurements.kind
        self._free = free_surface(device)
        self._has_finger = ~np.isnan(measurements.finger_m)
        attached_m: Any = measurements.position_m[:, None]
        if self._has_finger.any():
            finger_m = np.where(self._has_finger, measurements.finger_m, measurements.position_m)
            attached_m = np.stack([measurements.position_m, finger_m], axis=1)
        attached = attached_m.shape[1]
        if measurements.force_m is not None:
            attached_m = np.column_stack([attached_m, measurements.force_m])
        self._place_m: Points
        self._place_m, place = np.unique(attached_m, return_inverse=True)
        places: Integers = place.reshape(len(attached_m), -1)
        self._place, self._forced = places[:, :attached], None if measurements.force_m is None else places[:, -1]
        self._sensor_mass_kg = measurements.sensor_mass_kg
        self._tones = _split_tones(measurements)

    def predict(self, values: Array) -> Prediction:
        """Prediction with the parameters at these values (parameter,), SI."""
        tones, count = self._tones, len(self._parameters)
        device = with_values(self._device, self._parameters, values)
        plant = self._free.plant(device)
        acceleration = np.empty(len(tones.row), dtype=np.complex128)
        slope = np.empty((len(tones.row), count), dtype=np.complex128)
        for start in range(0, len(tones.frequency_hz), _CHUNK):
            chosen = slice(*np.searchsorted(tones.frequency, [start, start + _CHUNK]))
            loaded = self._load(plant, values, chosen, start)
            acceleration[chosen] = -(loaded.omega**2) * loaded.at_place[:, _SENSOR, 0]
            slope[chosen] = -(loaded.omega**2)[:, None] * self._slopes(plant, loaded, chosen)
        return self._combine(acceleration, slope)

    def _sensor_kg(self, values: Array) -> Array:
        """Mass (row,) of the sensors; a fitted mass replaces every one that is not 0."""
        for parameter, value in zip(self._parameters, values, strict=True):
            if parameter.part == "sensor":
                return np.where(self._sensor_mass_kg > 0, value, 0.0)
        return self._sensor_mass_kg

    def _load(self, plant: Plant, values: Array, chosen: slice, first: int) -> _Loaded:
        """Solve the bar at up to _CHUNK frequencies from `first` and attach each tone's sensor and finger.

        With the receptance g of the two places, the dynamic stiffness Z attached there and the deflection u of the
        bare bar, the loaded deflection is y = (1 + g Z)^-1 u, because Z exerts the force -Z y on the bar.
        """
        tones, actuators = self._tones, len(plant.device.actuators)
        place, frequency = self._place[tones.row[chosen]], tones.frequency[chosen] - first
        columns = solve_response(plant, tones.frequency_hz[first : first + _CHUNK], self._place_m).displacement_m
        omega = 2 * np.pi * tones.frequency_hz[tones.frequency[chosen]]
        if self._forced is None:
            bare = np.einsum("ta,tad->td", tones.drive[chosen], columns[frequency, :actuators])
        else:
            bare = columns[frequency, actuators + self._forced[tones.row[chosen]]]  # of 1 N
        points = columns[frequency[:, None], actuators + place]
        sampler = plant.sampler(self._place_m)
        weight, dof = sampler.weight[place], sampler.dof[place]
        tone, point = np.arange(len(place))[:, None, None], np.arange(place.shape[1])[:, None, None]
        receptance = np.einsum("tqpk,tpk->tpq", points[tone[..., None], point, dof[:, None]], weight)
        deflection = np.einsum("tpk,tpk->tp", bare[tone, dof], weight)
        Z = self._dynamic_stiffness(plant.device.finger, values, omega, chosen)
        system = np.eye(place.shape[1]) + receptance * Z[:, None, :]
        loaded = np.linalg.solve(system, deflection[..., None])[..., 0]
        share = np.linalg.inv(system)[:, _SENSOR, :]
        return _Loaded(
            omega=omega,
            field=bare - np.einsum("tpd,tp->td", points, Z * loaded),
            adjoint=np.einsum("tpd,tp->td", points, share),
            at_place=np.stack([loaded, np.einsum("tp,tpq->tq", share, receptance)], axis=-1),
        )

    def _dynamic_stiffness(self, finger: Finger, values: Array, omega: Array, chosen: slice) -> Complex:
        """Force per deflection (tone, place) of the sensor and the finger attached to the bar."""
        row = self._tones.row[chosen]
        out = np.zeros((len(row), self._place.shape[1]), dtype=np.complex128)
        out[:, _SENSOR] = -(omega**2) * self._sensor_kg(values)[row]
        if self._has_finger.any():
            stiffness = finger.stiffness_n_per_m + 1j * omega * finger.damping_n_s_per_m - omega**2 * finger.mass_kg
            out[:, _FINGER] = np.where(self._has_finger[row], stiffness, 0.0)
        return out

    def _slopes(self, plant: Plant, loaded: _Loaded, chosen: slice) -> Complex:
        """Derivatives (tone, parameter) of the deflection at the sensor.

        The adjoint field is that of a unit force at the sensor, since D is symmetric (docs/theory.md, calibration).
        """
        tones, jw = self._tones, (1j * loaded.omega).astype(np.complex128)
        drive, transfers = tones.drive[chosen], transfers_at(plant.device.actuators, jw)
        if self._forced is not None:
            drive = np.zeros_like(drive)  # the bases of the actuators are still
        if transfers is not None:
            drive = drive * transfers
        row, squares = tones.row[chosen], loaded.at_place.prod(axis=-1)
        sensor = squares[:, _SENSOR] * (self._sensor_mass_kg[row] > 0)
        attached = sensor, squares[:, -1] * self._has_finger[row]
        return force_slopes(self._free, plant, self._parameters, jw, (loaded.adjoint, loaded.field), attached, drive)

    def _combine(self, acceleration: Complex, slope: Complex) -> Prediction:
        """Sum the tones of each row: their peaks add (paper eq. (8)); a response has one tone."""
        rows, tones = len(self._sensor_mass_kg), self._tones
        if self._kind is Kind.RESPONSE:
            order = np.argsort(tones.row)
            return Prediction(np.log(acceleration[order]), slope[order] / acceleration[order, None])
        size = np.maximum(np.abs(acceleration), _TINY)
        peak = np.bincount(tones.row, size, rows)
        rate = (acceleration.conj()[:, None] * slope).real / size[:, None]
        total = np.array([np.bincount(tones.row, column, rows) for column in rate.T]).reshape(-1, rows).T
        return Prediction(np.log(peak).astype(np.complex128), (total / peak[:, None]).astype(np.complex128))


def force_slopes(
    free: FreeSurface,
    plant: Plant,
    parameters: Sequence[Parameter],
    s_per_s: Complex,
    fields: tuple[Complex, Complex],
    attached: tuple[Complex, Complex],
    drive: Complex,
) -> Complex:
    """Derivatives (row, parameter) of q^T (F - D w) at complex frequencies (row,) by the SI values of the parameters.

    D is the dynamic stiffness of the plant, F the force of its actuators under base displacements `drive` (row,
    actuator) in fractions of full scale. fields: q and w (row, degree of freedom); attached: products of their
    deflections (row,) at the sensor and at the finger, 0 where none is.
    """
    (q, w), s, device, surface = fields, s_per_s, plant.device, plant.device.surface
    kind, actuators = surface.kind, device.actuators
    at, field = (plant.actuators.sample(each) for each in fields)
    base_m = drive * np.array([actuator.full_scale_m for actuator in actuators])
    stretch = at * (base_m - field)
    k, c, m = np.array([(a.stiffness_n_per_m, a.damping_n_s_per_m, a.mass_kg) for a in actuators]).T
    strain, moved = free.strain(device, q, w), -free.motion(device, q, w)
    E, rho = surface.youngs_modulus_pa, surface.density_kg_per_m3
    sigma, eta = surface.mass_damping_per_s, surface.stiffness_damping_s
    # damping_of "assembly": sigma and eta also damp the actuators' masses and springs.
    damped = -s[:, None] * at * field * (surface.damping_of == "assembly")
    sensor, finger = -attached[0], -attached[1]
    single = {
        **{(kind, key): -(1 + s * eta) * value for key, value in strain.items()},
        (kind, "density"): (s**2 + s * sigma) * moved,
        (kind, "mass_damping"): s * rho * moved + damped @ m,
        (kind, "stiffness_damping"): -s * E * strain["youngs_modulus"] + damped @ k,
        ("finger", "stiffness"): finger,
        ("finger", "damping"): s * finger,
        ("finger", "mass"): s**2 * finger,
        ("sensor", "mass"): s**2 * sensor,
    }
    own = {
        "stiffness": stretch + eta * damped,
        "damping": s[:, None] * stretch,
        "full_scale": at * (k + s[:, None] * c) * drive,
        "mass": -(s**2)[:, None] * at * field + sigma * damped,
        "delay": -s[:, None] * at * (k + s[:, None] * c) * base_m,
        "clamp": -(1 + s * eta)[:, None] * plant.clamp_slopes(q, w),
    }
    slopes = [
        own[p.key][:, list(p.actuators)].sum(axis=1) if p.part == "actuator" else single[p.part, p.key]
        for p in parameters
    ]
    return np.array(slopes, dtype=np.complex128).reshape(len(slopes), len(s)).T


def _split_tones(measurements: Measurements) -> _Tones:
    """Split rows into tones; actuators of one row at the same frequency form one tone, since their fields add."""
    hz = np.where(np.abs(measurements.amplitude) > 0, measurements.frequency_hz, np.nan)
    every = np.unique(hz[~np.isnan(hz)])
    frequency, row = np.nonzero((hz[None] == every[:, None, None]).any(axis=2))
    drive = np.where(hz[row] == every[frequency][:, None], measurements.amplitude[row], 0)
    return _Tones(every, row, frequency, drive)


POINTS = 22  # measured points along the bar, as in the paper
_FIRST, _LAST = 0.02, 0.98  # fractions of each side: the middle of a sensor cannot be at the edge
_WRONG = 3.0  # a wrong range of the sensor; four standard deviations (OUTLIER) at 27 % noise


@dataclass(frozen=True)
class Flaws:
    """Relative standard deviation of a reading, and the share of readings that are 3 times too high or too low."""

    noise: float = 0.0
    wrong: float = 0.0


def even_places(device: Device, points: int = POINTS) -> Points:
    """Points (point,), evenly over the part of the surface that the middle of a sensor reaches.

    On a plate they are rows and columns, about as far apart; at most `points` of them.
    """
    corner_m = device.surface.corner_m
    rows = max(1, round((points * corner_m.imag / corner_m.real) ** 0.5))
    x_m = np.linspace(_FIRST, _LAST, points // rows) * corner_m.real
    y_m = np.linspace(_FIRST, _LAST, rows) * corner_m.imag
    return (x_m + 1j * y_m[:, None]).ravel() if isinstance(corner_m, complex) else x_m


def simulate_measurements(device: Device, layout: Measurements, flaws: Flaws, seed: int) -> Measurements:
    """The rows of `layout` with the readings that the device would give, flawed by a generator with this seed."""
    random = np.random.default_rng(seed)
    true = np.exp(MeasurementModel(device, layout, ()).predict(np.zeros(0)).log_acceleration)
    rows = len(layout)
    noise = random.standard_normal(rows)
    if layout.kind is Kind.RESPONSE:
        noise = (noise + 1j * random.standard_normal(rows)).astype(np.complex128)
    factor = np.exp(flaws.noise * noise)
    wrong = random.permutation(rows)[: round(flaws.wrong * rows)]
    factor[wrong] *= np.where(random.random(len(wrong)) < 0.5, _WRONG, 1 / _WRONG)
    return replace(layout, acceleration=true * factor, is_simulated=True)
