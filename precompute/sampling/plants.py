"""Sampled plants: bar, actuators and fingers of a device varied within its spread."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
from scipy.special import ndtri

from base.arrays import Array, Complex, Mask, Points
from base.points import clip_points
from engine.device import Device, Finger, FittedValue, Uncertainty
from engine.device.parts import Bar, Plate
from precompute.measurements.parameters import Parameter, find_parameters, values_at, with_values

_WITHIN = 1.96  # standard deviations of 95 % of a normal distribution to both sides
_FURTHER = {  # fields of Spread beside stiffness and mass: keys of the surface and the actuator that a calibration fits
    "length": ("length", ""),
    "damping": ("stiffness_damping", "damping"),
    "gain": ("", "full_scale"),
    "delay_s": ("", "delay"),
    "clamp_m": ("", "clamp"),
}
_LENGTHS = 8  # different ones of a device: each has modes of its own, which take a plate 70 ms
_EVEN = ("delay_s", "clamp_m")  # distributed evenly, the others normally
_DRAWS_AT_ONCE = 16


@dataclass(frozen=True)
class Fingers:
    """Fingers of a placement in every scenario: position, stiffness, damping and mass, each (scenario, finger)."""

    position_m: Points
    stiffness_n_per_m: Array
    damping_n_s_per_m: Array
    mass_kg: Array

    def first(self, scenarios: int) -> "Fingers":
        """The fingers of the first scenarios."""
        columns = (self.stiffness_n_per_m, self.damping_n_s_per_m, self.mass_kg)
        return Fingers(self.position_m[:scenarios], *(column[:scenarios] for column in columns))

    def of(self, scenario: int) -> list[tuple[complex, Finger]]:
        """Position in metres and finger of one scenario, for each finger."""
        columns = (self.position_m, self.stiffness_n_per_m, self.damping_n_s_per_m, self.mass_kg)
        return [
            (at_m, Finger(mass_kg=mass, damping_n_s_per_m=damping, stiffness_n_per_m=stiffness, spread=1.0))
            for at_m, stiffness, damping, mass in zip(*(column[scenario].tolist() for column in columns), strict=True)
        ]


@dataclass(frozen=True)
class Scenarios:
    """Sampled bars and actuators of one device, the nominal ones first; `place` puts fingers on them.

    calibrated (scenario,): devices that the measurements of a calibration do not tell apart, the same one where there
    was none; with other lengths and dampings where the spread has these. Factors beside it: bar_stiffness, bar_mass
    (scenario,); stiffness, mass, gain (scenario, actuator), and delay_s of each channel. normal (scenario, parameter):
    the standardised deviates that these come from.
    """

    device: Device
    seed: int
    calibrated: tuple[Device, ...]
    bar_stiffness: Array
    bar_mass: Array
    stiffness: Array
    mass: Array
    gain: Array
    delay_s: Array
    normal: Array

    def __len__(self) -> int:
        """Number of scenarios, the nominal one included."""
        return len(self.bar_mass)

    def device_of(self, scenario: int) -> Device:
        """The device with the surface and the actuators of one scenario, its channels' gains in their full scales."""
        base = self.calibrated[scenario]
        surface = replace(
            base.surface,
            youngs_modulus_pa=base.surface.youngs_modulus_pa * float(self.bar_stiffness[scenario]),
            density_kg_per_m3=base.surface.density_kg_per_m3 * float(self.bar_mass[scenario]),
        )
        factors = zip(*(each[scenario].tolist() for each in (self.stiffness, self.mass, self.gain)), strict=True)
        actuators = tuple(
            replace(other := actuator.scaled(k, m), full_scale_m=other.full_scale_m * gain)
            for actuator, (k, m, gain) in zip(base.actuators, factors, strict=True)
        )
        return replace(base, surface=surface, actuators=actuators)

    def channels(self, s_per_s: Complex) -> Complex | None:
        """Factor exp(-s delay) of every channel (scenario, actuator, line), or None for channels without a delay."""
        if not self.delay_s.any():
            return None
        return np.asarray(np.exp(-self.delay_s[..., None] * s_per_s), dtype=np.complex128)

    def deviations(self, fingers: int) -> Array:
        """What varies (scenario, parameter), standardised: bar, actuators, and that many fingers."""
        return np.hstack([self.normal, _rows(self._touches(fingers))])

    def _touches(self, fingers: int) -> Array:
        return _sample_touches((len(self) - 1) // 2, fingers, _axes(self.device), self.seed)

    def place(self, position_m: Sequence[complex], tolerance_m: float | None = None) -> Fingers:
        """Sampled fingers about these positions, which rise along the bar; the nominal ones are exactly there.

        Each lies within `tolerance_m` of its position (None: as the device's spread says), and on the bar.
        """
        finger, corner_m = self.device.finger, self.device.surface.corner_m
        reach_m = self.device.spread.reach_m if tolerance_m is None else tolerance_m
        *way, mass, damping, stiffness = self._touches(len(position_m))
        place = way[0] if len(way) == 1 else way[0] + 1j * way[1]
        return Fingers(
            position_m=clip_points(np.array(position_m) + reach_m * place, corner_m),
            stiffness_n_per_m=finger.stiffness_n_per_m * finger_factors(self.device, stiffness),
            damping_n_s_per_m=finger.damping_n_s_per_m * finger_factors(self.device, damping),
            mass_kg=finger.mass_kg * finger_factors(self.device, mass),
        )


def sample_scenarios(device: Device, count: int, seed: int) -> Scenarios:
    """The nominal plant and `count` sampled ones (a seeded Latin hypercube; an odd count is rounded up).

    They lie within the spread of the device; what a calibration has fitted varies as that has left it. Every other
    sample is the mirror image of the one before, so that a mirrored bar gets mirrored clicks.
    """
    spread, pairs = device.spread, (count + 1) // 2
    drawn = _normal_deviates(device, pairs, seed)
    normal = _with_images(drawn)
    further, columns = _further_deviates(device, pairs, seed)
    off = {key: _with_images(value) for key, value in further.items()}
    guessed = ~np.array([_fitted(device, "youngs_modulus", "stiffness"), _fitted(device, "density", "mass")])
    stiff = 1 + spread.stiffness * guessed[0] * normal[:, ::2]
    heavy = 1 + spread.mass * guessed[1] * normal[:, 1::2]
    calibrated = (device, *_calibrated(device, pairs, seed))
    if max(spread.length, spread.damping, spread.clamp_m) > 0:
        others = zip((1 + off["length"][:, 0]).tolist(), np.exp(off["damping"]), off["clamp_m"][:, 1:], strict=True)
        calibrated = tuple(_altered(each, *other) for each, other in zip(calibrated, others, strict=True))
    return Scenarios(
        device=device,
        seed=seed,
        calibrated=calibrated,
        bar_stiffness=stiff[:, 0],
        bar_mass=heavy[:, 0],
        stiffness=stiff[:, 1:],
        mass=heavy[:, 1:],
        gain=1 + off["gain"][:, 1:],
        delay_s=off["delay_s"][:, 1:],
        normal=np.hstack([normal, _with_images(columns)]),
    )


def finger_factors(device: Device, deviation: Array) -> Array:
    """Factors of a finger's mass, damping or stiffness, by deviations from -1 to 1 of the spread."""
    if device.spread.finger is None:
        return np.asarray(device.finger.spread ** (ndtri((1 + deviation) / 2) / _WITHIN), dtype=np.float64)
    return 1 + device.spread.finger * deviation


def sample_deviations(device: Device, count: int, fingers: int, seed: int) -> Array:
    """`Scenarios.deviations` of `count` plants, which need not be made for it; without the nominal one."""
    pairs = (count + 1) // 2
    drawn = np.hstack([_normal_deviates(device, pairs, seed), _further_deviates(device, pairs, seed)[1]])
    normal = np.repeat(drawn, 2, axis=0)
    return np.hstack([normal, _rows(_sample_touches(pairs, fingers, _axes(device), seed))[1:]])


def latin_hypercube(count: int, dimensions: int, random: np.random.Generator) -> Array:
    """Points (point, dimension) from 0 to 1: in each dimension one in each of `count` equal intervals.

    The numbers are those of `scipy.stats.qmc.LatinHypercube`, whose import takes 0.4 s.
    """
    within = random.uniform(size=(count, dimensions))
    interval = np.tile(np.arange(1, count + 1), (dimensions, 1))
    for row in interval:
        random.shuffle(row)
    return (interval.T - within) / count


def _normal_deviates(device: Device, pairs: int, seed: int) -> Array:
    """Standard normal deviates (pair, parameter) of bar and actuators."""
    return ndtri(latin_hypercube(pairs, 2 + 2 * len(device.actuators), np.random.default_rng(seed)))


def _rows(touches: Array) -> Array:
    """`_sample_touches` as rows (scenario, parameter)."""
    return touches.transpose(1, 0, 2).reshape(touches.shape[1], -1)


def _axes(device: Device) -> int:
    """Axes along which a finger's place varies: one on a bar, two on a plate."""
    return 2 if isinstance(device.surface.corner_m, complex) else 1


@lru_cache(maxsize=64)
def _sample_touches(pairs: int, fingers: int, axes: int, seed: int) -> Array:
    """Deviations (parameter, scenario, finger) from -1 to 1 of place by axis, mass, damping, stiffness; nominal first.

    A mirror image has the fingers in the opposite order, and their places on the other side.
    """
    (random,) = np.random.default_rng([seed, fingers]).spawn(1)
    touch = 2 * latin_hypercube(pairs, (axes + 3) * fingers, random).reshape(pairs, axes + 3, fingers) - 1
    image = touch[:, :, ::-1].copy()
    image[:, 0] *= -1
    nominal, both = np.zeros((1, *touch.shape[1:])), np.stack([touch, image], axis=1).reshape(-1, *touch.shape[1:])
    deviation: Array = np.concatenate([nominal, both]).transpose(1, 0, 2)
    deviation.flags.writeable = False
    return deviation


def _calibrated(device: Device, pairs: int, seed: int) -> Iterator[Device]:
    """Devices that a calibration leaves possible, each twice, for a sample and its mirror image."""
    if device.uncertainty is None:
        return (device for _ in range(2 * pairs))
    return (each for each in sample_devices(device, device.uncertainty, pairs, seed) for _ in range(2))


def _further_deviates(device: Device, pairs: int, seed: int) -> tuple[dict[str, Array], Array]:
    """By field of `_FURTHER` what is added (pair, part), the surface first; and the standardised deviates of all.

    deviates (pair, parameter): of what varies alone, so that a spread without these has none.
    """
    guesses = {
        key: (np.array([bool(names[0]), *[bool(names[1])] * len(device.actuators)]) & ~_fitted(device, *names))
        for key, names in _FURTHER.items()
        if key != "clamp_m" or isinstance(device.surface, Bar)
    }
    live = {key: guess if getattr(device.spread, key) else np.zeros_like(guess) for key, guess in guesses.items()}
    random = np.random.default_rng([seed, 1])
    even = latin_hypercube(pairs, int(sum(each.sum() for each in live.values())), random)
    found = {key: np.zeros((pairs, 1 + len(device.actuators))) for key in _FURTHER}
    columns, first = list[Array](), 0
    for key, parts in live.items():
        own = even[:, first : first + int(parts.sum())]
        if key == "length":
            own = (np.floor(_LENGTHS * own) + 0.5) / _LENGTHS
        first += own.shape[1]
        deviate = 2 * own - 1 if key in _EVEN else ndtri(own)
        found[key][:, parts] = getattr(device.spread, key) * ((1 + deviate) / 2 if key == "clamp_m" else deviate)
        columns.append(deviate)
    return found, np.hstack(columns)


def _altered(device: Device, length: float, damping: Array, clamp_m: Array) -> Device:
    """The device with its sides, and the damping of its surface and its actuators, multiplied, and wider clamps.

    Actuators and borders of zones stay as far from the nearer end as they are.
    """
    surface, corner_m = device.surface, device.surface.corner_m
    moved = partial(_moved_on, corner_m=corner_m, away_m=(length - 1) * corner_m)
    factors = damping.tolist()
    surface = replace(
        surface,
        length_m=surface.length_m * length,
        width_m=surface.width_m * (length if isinstance(surface, Plate) else 1.0),
        mass_damping_per_s=surface.mass_damping_per_s * factors[0],
        stiffness_damping_s=surface.stiffness_damping_s * factors[0],
    )
    actuators = tuple(
        replace(
            each,
            damping_n_s_per_m=each.damping_n_s_per_m * factor,
            clamp_m=each.clamp_m + wider_m,
            position_m=moved(each.position_m),
        )
        for each, factor, wider_m in zip(device.actuators, factors[1:], clamp_m.tolist(), strict=True)
    )
    zones = tuple(replace(each, start_m=moved(each.start_m), stop_m=moved(each.stop_m)) for each in device.zones)
    return replace(device, surface=surface, actuators=actuators, zones=zones)


def _moved_on(at_m: complex, corner_m: complex, away_m: complex) -> complex:
    """A point that moves with the corner `corner_m` along each axis where it is nearer to that than to the start."""
    x_m = at_m.real + away_m.real * (at_m.real > corner_m.real / 2)
    y_m = at_m.imag + away_m.imag * (at_m.imag > corner_m.imag / 2)
    return complex(x_m, y_m) if isinstance(corner_m, complex) else x_m


def _fitted(device: Device, of_surface: str, of_actuator: str) -> Mask:
    """Whether a calibration has fitted these values (part,) of the surface and of every actuator, by their keys."""
    names = {value.name for value in device.uncertainty.fitted} if device.uncertainty is not None else set[str]()
    own = [("actuator", f"actuator[{i}]") for i in range(1, len(device.actuators) + 1)]
    return np.array(
        [
            f"{device.surface.kind}.{of_surface}" in names,
            *[not names.isdisjoint(f"{part}.{of_actuator}" for part in parts) for parts in own],
        ]
    )


def _with_images(drawn: Array) -> Array:
    """Deviates (scenario, parameter): 0 of the nominal plant, then those drawn (pair, parameter), each twice."""
    return np.concatenate([np.zeros((1, drawn.shape[1])), np.repeat(drawn, 2, axis=0)])


def sample_devices(device: Device, uncertainty: Uncertainty, count: int, seed: int) -> list[Device]:
    """`count` devices that the measurements cannot tell from `device`, by a seed; fitted values vary together.

    Coordinates are normal about the device's values, with the covariance of the calibration, within its bounds.
    """
    parameters = _parameters(device, uncertainty.fitted)
    centre, low, high = np.array([[p.coordinate(value) for value in (p.start, p.low, p.high)] for p in parameters]).T
    square, vector = np.linalg.eigh(np.array(uncertainty.covariance))
    root = vector * np.sqrt(np.maximum(square, 0.0))
    random = np.random.default_rng(seed)
    devices = []
    for _ in range(count):
        draws = centre + random.standard_normal((_DRAWS_AT_ONCE, len(centre))) @ root.T
        inside = np.flatnonzero(((draws >= low) & (draws <= high)).all(axis=1))
        chosen = np.clip(draws[inside[0] if len(inside) else 0], low, high)
        devices.append(with_values(device, parameters, values_at(parameters, chosen)))
    return devices


def _parameters(device: Device, fitted: tuple[FittedValue, ...]) -> tuple[Parameter, ...]:
    bounds = {value.name: (value.low, value.high) for value in fitted}
    found = find_parameters(device, [value.name for value in fitted], bounds, 0.0)
    return tuple(replace(parameter, knee=value.knee) for parameter, value in zip(found, fitted, strict=True))
