"""A plant: the surface of a device on its actuators, as matrices over degrees of freedom, whatever the surface is.

Bars are finite elements (`precompute.model.assembly`); plates, and bars with inertial actuators, are modes
(`precompute.model.modal_plant`). All that follows, from responses to sweeps and clicks, needs what is declared here and
no more.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from base.arrays import Array, Complex, even_points
from engine.device import Actuator, Device, Finger

_ZONE_PLACES = {"bar": (1, 257), "plate": (17, 17)}
"""Places looked at across and along a zone before a peak is interpolated: on a bar its height is right to 1e-6."""


@dataclass(frozen=True)
class Sampler:
    """Rows of shape functions that read a field at points: degrees of freedom and their weights, (point, k) each."""

    dof: NDArray[np.int64]
    weight: Array

    def sample(self, field: Complex) -> Complex:
        """Shape (..., point) from a field (..., degree of freedom)."""
        values: Complex = np.einsum("...pk,pk->...p", field[..., self.dof], self.weight)
        return values

    def shapes(self, shape: Array) -> Array:
        """Shape (point, mode) from mode shapes (degree of freedom, mode)."""
        values: Array = np.einsum("pkm,pk->pm", shape[self.dof], self.weight)
        return values


def moved_masses(actuators: Sequence[Actuator]) -> Array:
    """Shape (mass,), kg: what each actuator puts on the surface, then the moving masses of inertial ones."""
    moving = [actuator.moving_mass_kg for actuator in actuators if actuator.moving_mass_kg is not None]
    return np.array([*(actuator.mass_kg for actuator in actuators), *moving])


class Plant(ABC):
    """The untouched surface with its actuators; with `with_fingers` also with fingers."""

    device: Device

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of degrees of freedom."""

    @property
    @abstractmethod
    def actuators(self) -> Sampler:
        """The deflection that each actuator's spring and damper act on; relative to its moving mass, if it has one."""

    @property
    @abstractmethod
    def masses(self) -> Sampler:
        """The deflection of each mass of `moved_masses`."""

    @abstractmethod
    def sampler(self, position_m: NDArray[np.float64] | NDArray[np.complex128]) -> Sampler:
        """Sampler at points (point,) on the surface."""

    @abstractmethod
    def with_fingers(self, position_m: Sequence[complex], finger: Finger | Sequence[Finger]) -> "Plant":
        """The plant with a grounded finger at each point, assembled into the matrices (docs/theory.md#fingers)."""

    @property
    @abstractmethod
    def resolution(self) -> dict[str, int | float]:
        """Attributes of a table that say how finely the surface is resolved."""

    @abstractmethod
    def with_device(self, device: Device) -> Self:
        """The same matrices for a device that differs in what they do not depend on, such as its threshold curve."""

    @abstractmethod
    def dense(self) -> tuple[Array, Array, Array]:
        """K, C and M (degree of freedom, degree of freedom)."""

    @abstractmethod
    def solve(self, omega: Array, loads: Sampler, spring: Array, damper: Array) -> Complex:
        """Displacement (frequency, load, degree of freedom) under loads (spring + j omega damper) at their points."""

    @abstractmethod
    def gram(self, field: Complex) -> Complex:
        """Integrals (frequency, zone + 1, column, column) of conj(v_a) v_b over each zone and, last, what is in none.

        field: (frequency, column, degree of freedom).
        """

    @cached_property
    def zone_places_m(self) -> NDArray[np.float64] | NDArray[np.complex128]:
        """Points (zone, across, along) in each zone, edges included, where peaks are looked for; a bar has one row."""
        zones, (across, along) = self.device.zones, _ZONE_PLACES[self.device.surface.kind]
        each = [even_points(zone.start_m, zone.stop_m, along, across) for zone in zones]
        return np.array(each).reshape(len(zones), across, along)

    @cached_property
    def zone_sampler(self) -> Sampler:
        """Sampler at all `zone_places_m`, zone after zone."""
        return self.sampler(self.zone_places_m.ravel())

    @property
    def is_measured(self) -> bool:
        """Whether the responses to the actuators were measured: `known_drive` has them."""
        return False

    def known_drive(self, frequency_hz: Array) -> tuple[Array, Complex] | None:  # noqa: ARG002  # a model has none
        """Displacement of the untouched surface where it was measured: functions, and their share; else None.

        shape (degree of freedom, function); drive (function, actuator, frequency), metres at full scale.
        """
        return None
