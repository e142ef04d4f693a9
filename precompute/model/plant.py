"""A plant: the surface of a device on its actuators, as matrices over degrees of freedom, whatever the surface is.

Bars are finite elements (`precompute.model.assembly`); plates, and bars with inertial actuators, are modes
(`precompute.model.modal_plant`). All that follows, from responses to sweeps and clicks, needs what is declared here and
no more.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, Self

import numpy as np

from base.arrays import Array, Complex, Integers, Points, even_points
from engine.device import Actuator, Device, Finger

_ZONE_PLACES = {"bar": (1, 257), "plate": (17, 17)}
"""Places looked at across and along a zone before a peak is interpolated: on a bar its height is right to 1e-6."""


@dataclass(frozen=True)
class Sampler:
    """Rows of shape functions that read a field at points: degrees of freedom and their weights, (point, k) each."""

    dof: Integers
    weight: Array

    def sample(self, field: Complex) -> Complex:
        """Shape (..., point) from a field (..., degree of freedom)."""
        return np.einsum("...pk,pk->...p", field[..., self.dof], self.weight)

    def shapes(self, shape: Array) -> Array:
        """Shape (point, mode) from mode shapes (degree of freedom, mode)."""
        return np.einsum("pkm,pk->pm", shape[self.dof], self.weight)


def moved_masses(actuators: Sequence[Actuator]) -> Array:
    """Shape (mass,), kg: what each actuator puts on the surface, then the moving masses of inertial ones."""
    moving = [actuator.moving_mass_kg for actuator in actuators if actuator.moving_mass_kg is not None]
    return np.array([*(actuator.mass_kg for actuator in actuators), *moving])


class KnownDrive(Protocol):
    """What is known of a surface that moves as it was measured."""

    def at(self, frequency_hz: Array) -> tuple[Array, Complex]:
        """As `Plant.known_drive`."""


class Plant(ABC):
    """The untouched surface with its actuators; with `with_fingers` also with fingers."""

    device: Device
    known: KnownDrive | None

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
    def sampler(self, position_m: Array | Complex) -> Sampler:
        """Sampler at points (point,) on the surface."""

    @property
    @abstractmethod
    def resolution(self) -> dict[str, int | float]:
        """Attributes of a table that say how finely the surface is resolved."""

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

    def clamp_slopes(self, one: Complex, other: Complex) -> Complex:  # noqa: ARG002  # a plate has no clamps
        """Derivatives of one^T K other (row, actuator) by lengths of clamps; one, other (row, degree of freedom)."""
        return np.zeros((len(one), len(self.device.actuators)), dtype=np.complex128)

    @cached_property
    def zone_places_m(self) -> Array | Complex:
        """Points (zone, across, along) in each zone, edges included, where peaks are looked for; a bar has one row."""
        zones, (across, along) = self.device.zones, _ZONE_PLACES[self.device.surface.kind]
        each = [even_points(zone.start_m, zone.stop_m, along, across) for zone in zones]
        return np.array(each).reshape(len(zones), across, along)

    @cached_property
    def zone_sampler(self) -> Sampler:
        """Sampler at all `zone_places_m`, zone after zone."""
        return self.sampler(self.zone_places_m.ravel())

    @abstractmethod
    def through(self, position_m: Points) -> Array:
        """Shape (degree of freedom, point): the least bent fields that are 1 at one of the points and 0 at the others.

        On a bar they are natural cubic splines. Fields of a plate with more points than degrees of freedom come near.
        """

    @property
    def is_measured(self) -> bool:
        """Whether the responses to the actuators were measured: `known_drive` has them."""
        return self.known is not None

    def known_drive(self, frequency_hz: Array) -> tuple[Array, Complex] | None:
        """Displacement of the untouched surface where it was measured: functions, and their share; else None.

        shape (degree of freedom, function); drive (function, actuator, frequency), metres at full scale.
        """
        return None if self.known is None else self.known.at(frequency_hz)

    def with_fingers(self, position_m: Sequence[complex], finger: Finger | Sequence[Finger]) -> Self:
        """The plant with a grounded finger at each point, assembled into the matrices (docs/theory.md#fingers).

        Raises ValueError where the surface was measured, which was without fingers: predict.at_positions adds them.
        """
        if self.is_measured:
            raise ValueError(f"{finger} at {position_m} cannot be assembled into measured responses")
        return self._loaded(position_m, [finger] * len(position_m) if isinstance(finger, Finger) else list(finger))

    @abstractmethod
    def _loaded(self, position_m: Sequence[complex], fingers: Sequence[Finger]) -> Self:
        """The plant with these fingers at these points."""


class FreeSurface(ABC):
    """A surface without its actuators: makes plants of the same functions with other values of a device, for a fit."""

    @abstractmethod
    def plant(self, device: Device) -> Plant:
        """The plant of a device whose surface has the same lengths."""

    @abstractmethod
    def strain(self, device: Device, one: Complex, other: Complex) -> Mapping[str, Complex]:
        """Derivatives of one^T K other (row,) by the elastic values of the surface, by their keys in a device file.

        one, other (row, degree of freedom): fields of the plant of the device. K is proportional to Young's modulus.
        """

    @abstractmethod
    def motion(self, device: Device, one: Complex, other: Complex) -> Complex:
        """Derivative of one^T M other (row,) by the density, which M is proportional to."""
