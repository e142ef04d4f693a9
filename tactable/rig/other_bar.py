"""A bar that is not its table's: drawn from the spread of its device, touched by other fingers, beside where they seem.

The promises of a table are made over such bars. A demo that plays one shows what is left of them where the model is
wrong. SIMULATED.
"""

from functools import cached_property

import numpy as np

from base.points import clip_points
from engine.device import Device, Finger
from precompute.sampling.plants import finger_factors, sample_scenarios

_EQUAL = 1e-9  # a smaller difference is rounding
_BESIDE_M = 2e-3  # a table's places are 3 mm apart: its clicks are made for more than a digitizer's millimetre


def reach_beside_m(device: Device) -> float:
    """How far a finger may be from where it seems to be, evenly distributed to both sides along every axis."""
    return max(_BESIDE_M, device.spread.reach_m)


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
            random = np.random.default_rng([self._seed, contact])
            along, across = reach_beside_m(self.nominal) * random.uniform(-1, 1, 2)
            is_plate = isinstance(self.nominal.surface.corner_m, complex)
            mass, damping, stiffness = finger_factors(self.nominal, random.uniform(-1, 1, 3)).tolist()
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
        channels = max(abs(one.full_scale_m / other.full_scale_m - 1) for one, other in pairs)
        stiffness = now.surface.youngs_modulus_pa / was.surface.youngs_modulus_pa - 1
        mass = now.surface.density_kg_per_m3 / was.surface.density_kg_per_m3 - 1
        parts = [f"stiffness {_percent(stiffness)}, mass {_percent(mass)}, mounts up to {100 * mounts:.1f} % off"]
        if channels > _EQUAL:
            parts.append(f"channels up to {100 * channels:.1f} % off")
        widest = was.spread.finger
        fingers = "as people's are" if widest is None else f"up to {100 * widest:g} % off"
        return f"{', '.join(parts)}; fingers {fingers}, and {1e3 * reach_beside_m(was):g} mm beside"


def _percent(share: float) -> str:
    return f"{round(100 * share, 1) + 0.0:+.1f} %".replace("-", "\N{MINUS SIGN}")
