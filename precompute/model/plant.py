"""A plant: the surface of a device on its actuators, as matrices over degrees of freedom, whatever the surface is.

Bars are finite elements (`precompute.model.assembly`), plates are Ritz's functions (`precompute.model.plate`). All
that follows, from responses to sweeps and clicks, needs what is declared here and no more.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from base.arrays import Array, Complex
from engine.device import Device, Finger


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
        """The deflection at each actuator, which its spring and damper act on."""

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

    @property
    @abstractmethod
    def zone_places_m(self) -> NDArray[np.float64] | NDArray[np.complex128]:
        """Points (zone, across, along) in each zone, edges included, where peaks are looked for; a bar has one row."""

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
