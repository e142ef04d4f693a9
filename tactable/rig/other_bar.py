"""A bar that is not its table's: drawn from the spread of its device, touched by other fingers, beside where they seem.

The promises of a table are made over such bars. A demo that plays one shows what is left of them where the model is
wrong. SIMULATED.
"""

from functools import cached_property

import numpy as np

from base.points import clip_points
from engine.device import Device, Finger
from precompute.sampling.plants import sample_scenarios

BESIDE_M = 2e-3
"""How far a finger may be from where the digitizer says, evenly distributed to both sides along every axis."""


class OtherBar:
    """One bar of those that `seed` numbers, and the fingers on it, of which each contact has its own."""

    def __init__(self, device: Device, seed: int) -> None:
        self.nominal, self._seed = device, seed  # nominal: the device of the table
        self._touching = dict[int, tuple[complex, Finger]]()

    @cached_property
    def device(self) -> Device:
        """The device as it is."""
        return sample_scenarios(self.nominal, 1, self._seed).device_of(1)

    def finger_of(self, contact: int, at_m: complex) -> tuple[complex, Finger]:
        """Where the finger of a contact really is that seems to be at `at_m`, and what it is like."""
        if contact not in self._touching:
            random, widest = np.random.default_rng([self._seed, contact]), self.nominal.spread.finger
            along, across = BESIDE_M * random.uniform(-1, 1, 2)
            is_plate = isinstance(self.nominal.surface.corner_m, complex)
            mass, damping, stiffness = 1 + widest * random.uniform(-1, 1, 3)
            was = self.nominal.finger
            finger = Finger(
                was.mass_kg * mass, was.damping_n_s_per_m * damping, was.stiffness_n_per_m * stiffness, was.spread
            )
            beside_m = complex(along, across) if is_plate else along
            self._touching[contact] = beside_m, finger
        beside_m, finger = self._touching[contact]
        true_m: complex = clip_points(np.array(at_m + beside_m), self.nominal.surface.corner_m).item()
        return true_m, finger

    def __str__(self) -> str:
        """How it differs, in words."""
        was, now = self.nominal, self.device
        pairs = list(zip(now.actuators, was.actuators, strict=True))
        mounts = max(abs(one.stiffness_n_per_m / other.stiffness_n_per_m - 1) for one, other in pairs)
        stiffness = now.surface.youngs_modulus_pa / was.surface.youngs_modulus_pa - 1
        mass = now.surface.density_kg_per_m3 / was.surface.density_kg_per_m3 - 1
        return (
            f"stiffness {_percent(stiffness)}, mass {_percent(mass)}, mounts up to {100 * mounts:.1f} % off; fingers "
            f"up to {100 * was.spread.finger:g} % off and {1e3 * BESIDE_M:g} mm beside"
        )


def _percent(share: float) -> str:
    return f"{round(100 * share, 1) + 0.0:+.1f} %".replace("-", "\N{MINUS SIGN}")
