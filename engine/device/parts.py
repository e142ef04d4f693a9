"""The parts of a device description: immutable values in SI units, with all lengths from the start of the bar."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from firmware_link.protocol.errors import TactableError


class DeviceError(TactableError, ValueError):
    """A device description is wrong; the message names file, key, value and what was expected."""


@dataclass(frozen=True)
class Bar:
    """A uniform Euler-Bernoulli bar with the damping sigma M + eta K (paper eq. (2)).

    `damping_of` says whose M and K: those of the bar alone, or of the assembly with the actuators' springs and masses.
    """

    length_m: float
    width_m: float
    thickness_m: float
    youngs_modulus_pa: float
    density_kg_per_m3: float
    mass_damping_per_s: float
    stiffness_damping_s: float
    largest_element_m: float
    damping_of: Literal["bar", "assembly"] = "bar"


@dataclass(frozen=True)
class Actuator:
    """An electrostatic resonant actuator: spring and damper between the bar and a base that is driven."""

    name: str
    position_m: float
    stiffness_n_per_m: float
    damping_n_s_per_m: float
    mass_kg: float
    full_scale_m: float
    band_hz: tuple[float, float]


@dataclass(frozen=True)
class Zone:
    """A stretch of the bar that is felt, quiet or free as one."""

    name: str
    start_m: float
    stop_m: float

    @property
    def length_m(self) -> float:
        """Length of the zone."""
        return self.stop_m - self.start_m


@dataclass(frozen=True)
class Finger:
    """A grounded mass-damper-spring at the touch; `spread` is the factor its parameters vary by, up and down."""

    mass_kg: float
    damping_n_s_per_m: float
    stiffness_n_per_m: float
    spread: float


@dataclass(frozen=True)
class Spread:
    """What is not known of a device; clicks are made for all that lies within it.

    stiffness, mass: relative standard deviations, normal, of the bar and of every actuator. finger: its mass, damping
    and stiffness, evenly within plus and minus this fraction. finger_position_m: about the middle of its zone, evenly.
    """

    stiffness: float
    mass: float
    finger: float
    finger_position_m: float


@dataclass(frozen=True)
class TouchAxis:
    """How the digitizer lies on the bar: which logical axis, which way round, from where to where.

    A margin below zero: the touch area reaches beyond the bar; a touch out there counts as at the bar's end.
    """

    axis: Literal["x", "y"]
    flip: bool
    start_margin_m: float
    end_margin_m: float
    active_length_m: float | None
    """Length of the touch area; None: it reaches from `start_margin_m` to `end_margin_m` before the bar's end."""


@dataclass(frozen=True)
class Sweep:
    """The grid of the table: frequencies in Hz, amplitudes as fractions of full scale, steps in a turn of phase."""

    start_hz: float
    stop_hz: float
    step_hz: float
    amplitude_steps: int
    phase_steps: int

    @property
    def frequency_hz(self) -> NDArray[np.float64]:
        """Shape (frequency,): `start_hz` to `stop_hz`, both included."""
        steps = round((self.stop_hz - self.start_hz) / self.step_hz)
        return np.linspace(self.start_hz, self.stop_hz, steps + 1)

    @property
    def amplitude(self) -> NDArray[np.float64]:
        """Shape (amplitude,): 0 to 1, both included."""
        return np.linspace(0.0, 1.0, self.amplitude_steps + 1)


@dataclass(frozen=True)
class Limits:
    """What a drive must keep to: amplitude and slew in fractions of full scale."""

    amplitude: float
    slew_per_s: float
    lease_s: float


@dataclass(frozen=True)
class FittedValue:
    """A value that a calibration has fitted, by its name in the file; SI, within `low` and `high`.

    Its coordinate is its natural logarithm, or asinh(value / 2 knee) with a `knee` above 0.
    """

    name: str
    low: float
    high: float
    knee: float


@dataclass(frozen=True)
class Uncertainty:
    """What a calibration left unknown: covariance (value, value) of the coordinates of the values it fitted."""

    fitted: tuple[FittedValue, ...]
    covariance: tuple[tuple[float, ...], ...]
