"""Sampled plants: bar, actuators and fingers of a device varied within its spread."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri
from scipy.stats import qmc

from engine.device import Device, Finger
from precompute.sampling.devices import sample_devices

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Scenarios:
    """Sampled plants of one device, the nominal one first; factors unless the name has a unit.

    calibrated (scenario,): devices that the measurements of a calibration do not tell apart, the same one where there
    was none. Beside it bar_stiffness, bar_mass (scenario,); stiffness, mass (scenario, actuator): of the actuators;
    finger_mass, finger_damping, finger_stiffness, position_m (scenario, zone): of the finger that may lie in each zone.
    """

    device: Device
    calibrated: tuple[Device, ...]
    bar_stiffness: Array
    bar_mass: Array
    stiffness: Array
    mass: Array
    finger_mass: Array
    finger_damping: Array
    finger_stiffness: Array
    position_m: Array

    def __len__(self) -> int:
        """Number of scenarios, the nominal one included."""
        return len(self.bar_mass)

    def device_of(self, scenario: int) -> Device:
        """The device with the bar and the actuators of one scenario."""
        base = self.calibrated[scenario]
        bar = replace(
            base.bar,
            youngs_modulus_pa=base.bar.youngs_modulus_pa * float(self.bar_stiffness[scenario]),
            density_kg_per_m3=base.bar.density_kg_per_m3 * float(self.bar_mass[scenario]),
        )
        actuators = tuple(
            replace(actuator, stiffness_n_per_m=actuator.stiffness_n_per_m * k, mass_kg=actuator.mass_kg * m)
            for actuator, k, m in zip(
                base.actuators, self.stiffness[scenario].tolist(), self.mass[scenario].tolist(), strict=True
            )
        )
        return replace(base, bar=bar, actuators=actuators)

    def fingers_of(self, scenario: int, zones: Sequence[int]) -> list[tuple[float, Finger]]:
        """Position in metres and finger of one scenario, in each of `zones` (indices)."""
        finger = self.device.finger
        return [
            (
                float(self.position_m[scenario, zone]),
                Finger(
                    mass_kg=finger.mass_kg * float(self.finger_mass[scenario, zone]),
                    damping_n_s_per_m=finger.damping_n_s_per_m * float(self.finger_damping[scenario, zone]),
                    stiffness_n_per_m=finger.stiffness_n_per_m * float(self.finger_stiffness[scenario, zone]),
                    spread=1.0,
                ),
            )
            for zone in zones
        ]


def sample_scenarios(device: Device, count: int, seed: int) -> Scenarios:
    """The nominal plant and `count` sampled ones (a seeded Latin hypercube; an odd count is rounded up).

    They lie within the spread of the device; what a calibration has fitted varies as that has left it. Every other
    sample is the mirror image of the one before, so that a mirrored bar gets mirrored clicks.
    """
    spread = device.spread
    zones, actuators = len(device.zones), len(device.actuators)
    half = (count + 1) // 2
    points = qmc.LatinHypercube(2 + 2 * actuators + 4 * zones, seed=seed).random(half)
    solid, touch = points[:, : 2 + 2 * actuators], points[:, 2 + 2 * actuators :].reshape(half, 4, zones)
    image = touch[:, :, ::-1].copy()
    image[:, 0] = 1 - image[:, 0]
    normal = np.concatenate([np.zeros((1, solid.shape[1])), _alternating(ndtri(solid), ndtri(solid))])
    even = 2 * np.concatenate([np.full((1, 4, zones), 0.5), _alternating(touch, image)]) - 1
    middle_m = np.array([(zone.start_m + zone.stop_m) / 2 for zone in device.zones])
    reach_m = np.array([min(spread.finger_position_m, zone.length_m / 2) for zone in device.zones])
    guessed = ~_fitted(device)
    stiff = 1 + spread.stiffness * guessed[0] * normal[:, ::2]
    heavy = 1 + spread.mass * guessed[1] * normal[:, 1::2]
    return Scenarios(
        device=device,
        calibrated=(device, *_calibrated(device, half, seed)),
        bar_stiffness=stiff[:, 0],
        bar_mass=heavy[:, 0],
        stiffness=stiff[:, 1:],
        mass=heavy[:, 1:],
        finger_mass=1 + spread.finger * even[:, 1],
        finger_damping=1 + spread.finger * even[:, 2],
        finger_stiffness=1 + spread.finger * even[:, 3],
        position_m=middle_m + reach_m * even[:, 0],
    )


def _calibrated(device: Device, pairs: int, seed: int) -> Iterator[Device]:
    """Devices that a calibration leaves possible, each twice, for a sample and its mirror image."""
    if device.uncertainty is None:
        return (device for _ in range(2 * pairs))
    return (each for each in sample_devices(device, device.uncertainty, pairs, seed) for _ in range(2))


def _fitted(device: Device) -> NDArray[np.bool_]:
    """Whether a calibration has fitted the stiffness and the mass (2, part) of the bar and of every actuator."""
    names = {value.name for value in device.uncertainty.fitted} if device.uncertainty is not None else set[str]()
    own = [("actuator", f"actuator[{i}]") for i in range(1, len(device.actuators) + 1)]
    return np.array(
        [
            [bar in names, *[not names.isdisjoint(f"{part}.{key}" for part in parts) for parts in own]]
            for bar, key in (("bar.youngs_modulus", "stiffness"), ("bar.density", "mass"))
        ]
    )


def _alternating(one: Array, other: Array) -> Array:
    """The rows of both in turn."""
    rows: Array = np.stack([one, other], axis=1).reshape(-1, *one.shape[1:])
    return rows
