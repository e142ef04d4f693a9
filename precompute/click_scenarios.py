"""A device to the plants it may turn out to be: bar, actuators and fingers varied within what is not known of them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri
from scipy.stats import qmc

from engine.device import Device, Finger

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Spreads:
    """What is not known of a device (PHYSICS.md section 4); stiffness and mass of the bar and of every actuator.

    stiffness, mass: relative standard deviations, normal. finger: its mass, damping and stiffness, evenly within plus
    and minus this fraction. position_m: of the finger about the middle of its zone, evenly, within the zone.
    """

    stiffness: float = 0.01
    mass: float = 0.01
    finger: float = 0.3
    position_m: float = 0.004


DEFAULT_SPREADS = Spreads()


@dataclass(frozen=True)
class Scenarios:
    """Sampled plants of one device, the nominal one first; relative to nominal unless the name has a unit.

    bar_stiffness, bar_mass (scenario,); stiffness, mass (scenario, actuator): of the actuators; finger_mass,
    finger_damping, finger_stiffness, position_m (scenario, zone): of the finger that may lie in each zone.
    """

    device: Device
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
        base = self.device
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


def sample_scenarios(device: Device, count: int, seed: int, spreads: Spreads = DEFAULT_SPREADS) -> Scenarios:
    """The nominal plant and `count` sampled ones (a seeded Latin hypercube; an odd count is rounded up).

    Every other sample is the mirror image of the one before, so that a mirrored bar gets mirrored clicks.
    """
    zones, actuators = len(device.zones), len(device.actuators)
    half = (count + 1) // 2
    points = qmc.LatinHypercube(2 + 2 * actuators + 4 * zones, seed=seed).random(half)
    solid, touch = points[:, : 2 + 2 * actuators], points[:, 2 + 2 * actuators :].reshape(half, 4, zones)
    image = touch[:, :, ::-1].copy()
    image[:, 0] = 1 - image[:, 0]
    normal = np.concatenate([np.zeros((1, solid.shape[1])), _alternating(ndtri(solid), ndtri(solid))])
    even = 2 * np.concatenate([np.full((1, 4, zones), 0.5), _alternating(touch, image)]) - 1
    middle_m = np.array([(zone.start_m + zone.stop_m) / 2 for zone in device.zones])
    reach_m = np.array([min(spreads.position_m, zone.length_m / 2) for zone in device.zones])
    stiff, heavy = 1 + spreads.stiffness * normal[:, ::2], 1 + spreads.mass * normal[:, 1::2]
    return Scenarios(
        device=device,
        bar_stiffness=stiff[:, 0],
        bar_mass=heavy[:, 0],
        stiffness=stiff[:, 1:],
        mass=heavy[:, 1:],
        finger_mass=1 + spreads.finger * even[:, 1],
        finger_damping=1 + spreads.finger * even[:, 2],
        finger_stiffness=1 + spreads.finger * even[:, 3],
        position_m=middle_m + reach_m * even[:, 0],
    )


def _alternating(one: Array, other: Array) -> Array:
    """Their rows in turn."""
    rows: Array = np.stack([one, other], axis=1).reshape(-1, *one.shape[1:])
    return rows
