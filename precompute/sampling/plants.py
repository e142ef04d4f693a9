"""Sampled plants: bar, actuators and fingers of a device varied within its spread."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.special import ndtri

from base.arrays import Array, Mask, Points
from base.points import clip_points
from engine.device import Device, Finger
from precompute.sampling.devices import sample_devices


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
    was none. Factors beside it: bar_stiffness, bar_mass (scenario,); stiffness, mass (scenario, actuator). normal
    (scenario, parameter): the standard normal deviates that these come from.
    """

    device: Device
    seed: int
    calibrated: tuple[Device, ...]
    bar_stiffness: Array
    bar_mass: Array
    stiffness: Array
    mass: Array
    normal: Array

    def __len__(self) -> int:
        """Number of scenarios, the nominal one included."""
        return len(self.bar_mass)

    def device_of(self, scenario: int) -> Device:
        """The device with the bar and the actuators of one scenario."""
        base = self.calibrated[scenario]
        surface = replace(
            base.surface,
            youngs_modulus_pa=base.surface.youngs_modulus_pa * float(self.bar_stiffness[scenario]),
            density_kg_per_m3=base.surface.density_kg_per_m3 * float(self.bar_mass[scenario]),
        )
        factors = self.stiffness[scenario].tolist(), self.mass[scenario].tolist()
        actuators = tuple(actuator.scaled(k, m) for actuator, k, m in zip(base.actuators, *factors, strict=True))
        return replace(base, surface=surface, actuators=actuators)

    def deviations(self, fingers: int) -> Array:
        """What varies (scenario, parameter), standardised: bar, actuators, and that many fingers."""
        return np.hstack([self.normal, _rows(self._touches(fingers))])

    def _touches(self, fingers: int) -> Array:
        return _sample_touches((len(self) - 1) // 2, fingers, _axes(self.device), self.seed)

    def place(self, position_m: Sequence[complex], tolerance_m: float | None = None) -> Fingers:
        """Sampled fingers about these positions, which rise along the bar; the nominal ones are exactly there.

        Each lies within `tolerance_m` of its position (None: as the device's spread says), and on the bar.
        """
        finger, spread, corner_m = self.device.finger, self.device.spread, self.device.surface.corner_m
        reach_m = spread.finger_position_m if tolerance_m is None else tolerance_m
        *way, mass, damping, stiffness = self._touches(len(position_m))
        place = way[0] if len(way) == 1 else way[0] + 1j * way[1]
        return Fingers(
            position_m=clip_points(np.array(position_m) + reach_m * place, corner_m),
            stiffness_n_per_m=finger.stiffness_n_per_m * (1 + spread.finger * stiffness),
            damping_n_s_per_m=finger.damping_n_s_per_m * (1 + spread.finger * damping),
            mass_kg=finger.mass_kg * (1 + spread.finger * mass),
        )


def sample_scenarios(device: Device, count: int, seed: int) -> Scenarios:
    """The nominal plant and `count` sampled ones (a seeded Latin hypercube; an odd count is rounded up).

    They lie within the spread of the device; what a calibration has fitted varies as that has left it. Every other
    sample is the mirror image of the one before, so that a mirrored bar gets mirrored clicks.
    """
    spread, pairs = device.spread, (count + 1) // 2
    drawn = _normal_deviates(device, pairs, seed)
    normal = np.concatenate([np.zeros((1, drawn.shape[1])), _alternating(drawn, drawn)])
    guessed = ~_fitted(device)
    stiff = 1 + spread.stiffness * guessed[0] * normal[:, ::2]
    heavy = 1 + spread.mass * guessed[1] * normal[:, 1::2]
    return Scenarios(
        device=device,
        seed=seed,
        calibrated=(device, *_calibrated(device, pairs, seed)),
        bar_stiffness=stiff[:, 0],
        bar_mass=heavy[:, 0],
        stiffness=stiff[:, 1:],
        mass=heavy[:, 1:],
        normal=normal,
    )


def sample_deviations(device: Device, count: int, fingers: int, seed: int) -> Array:
    """`Scenarios.deviations` of `count` plants, which need not be made for it; without the nominal one."""
    pairs = (count + 1) // 2
    normal = np.repeat(_normal_deviates(device, pairs, seed), 2, axis=0)
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
    nominal = np.zeros((1, axes + 3, fingers))
    deviation: Array = np.concatenate([nominal, _alternating(touch, image)]).transpose(1, 0, 2)
    deviation.flags.writeable = False
    return deviation


def _calibrated(device: Device, pairs: int, seed: int) -> Iterator[Device]:
    """Devices that a calibration leaves possible, each twice, for a sample and its mirror image."""
    if device.uncertainty is None:
        return (device for _ in range(2 * pairs))
    return (each for each in sample_devices(device, device.uncertainty, pairs, seed) for _ in range(2))


def _fitted(device: Device) -> Mask:
    """Whether a calibration has fitted the stiffness and the mass (2, part) of the bar and of every actuator."""
    names = {value.name for value in device.uncertainty.fitted} if device.uncertainty is not None else set[str]()
    kind = device.surface.kind
    own = [("actuator", f"actuator[{i}]") for i in range(1, len(device.actuators) + 1)]
    return np.array(
        [
            [bar in names, *[not names.isdisjoint(f"{part}.{key}" for part in parts) for parts in own]]
            for bar, key in ((f"{kind}.youngs_modulus", "stiffness"), (f"{kind}.density", "mass"))
        ]
    )


def _alternating(one: Array, other: Array) -> Array:
    """The rows of both in turn."""
    return np.stack([one, other], axis=1).reshape(-1, *one.shape[1:])
