"""The parts of a device description: immutable values in SI units, with all lengths from the start of the bar."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from base.errors import TactableError
from engine.device.electrodes import Electrodes
from engine.device.transfer import Transfer


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

    def wave_number_per_m(self, frequency_hz: float) -> float:
        """Wave number of free bending, (rho A omega^2 / E I)^(1/4)."""
        slowness = math.sqrt(12 * self.density_kg_per_m3 / self.youngs_modulus_pa)
        return math.sqrt(2 * math.pi * frequency_hz * slowness / self.thickness_m)


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
    transfer: Transfer | None = None
    """From a command to the displacement of the base; None: the base moves as commanded."""
    electrodes: Electrodes | None = None
    """How the force follows the voltage, and what linearises it; None: the file does not say."""


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
    """A grounded mass-damper-spring at the touch; `spread` is the factor by which its values vary, up and down."""

    mass_kg: float
    damping_n_s_per_m: float
    stiffness_n_per_m: float
    spread: float


@dataclass(frozen=True)
class Spread:
    """The uncertainty of a device; clicks are made robust against all of it.

    stiffness, mass: relative standard deviations (normal) of the bar and of every actuator. finger: mass, damping and
    stiffness vary evenly within plus and minus this fraction. finger_position_m: offset from the middle of the zone,
    evenly distributed within plus and minus this length.
    """

    stiffness: float
    mass: float
    finger: float
    finger_position_m: float


@dataclass(frozen=True)
class TouchAxis:
    """How the digitizer lies on the bar, along which axis and how far, and when its contacts have lifted.

    A negative margin: the touch area reaches beyond the bar, and a touch there counts as one at the bar's end.
    """

    axis: Literal["x", "y"]
    flip: bool
    start_margin_m: float
    end_margin_m: float
    active_length_m: float | None
    """Length of the touch area; None: it ends `end_margin_m` before the end of the bar."""
    silence_s: float | None = None
    """Time without a frame after which every contact has lifted; None: as the Linux kernel does."""
    debounce_s: float = 0.0
    """A contact that lifts for less than this time stays down."""


@dataclass(frozen=True)
class Sweep:
    """The grid of the sweep: frequencies, amplitude steps up to full scale, and phase steps in a full turn.

    is_stored: whether a table holds every row, or only the best ones, which zones play.
    """

    start_hz: float
    stop_hz: float
    step_hz: float
    amplitude_steps: int
    phase_steps: int
    is_stored: bool = True

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
    """Limits of every drive: amplitude and slew rate as fractions of full scale, and the time a drive is leased for."""

    amplitude: float
    slew_per_s: float
    lease_s: float


@dataclass(frozen=True)
class FittedValue:
    """A value that a calibration fitted, by its name in the file, with its bounds `low` and `high` in SI units.

    The fit's coordinate is the natural logarithm of the value, or asinh(value / 2 knee) with a `knee` above 0.
    """

    name: str
    low: float
    high: float
    knee: float


@dataclass(frozen=True)
class Uncertainty:
    """Covariance (value, value) that a calibration left, of the coordinates of the fitted values."""

    fitted: tuple[FittedValue, ...]
    covariance: tuple[tuple[float, ...], ...]
