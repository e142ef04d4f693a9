"""The parts of a device description: immutable values in SI units, with all points from the start of the surface."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from base.arrays import Array
from base.errors import TactableError
from engine.device.actuator_transfer import Transfer

_GREATEST_WORD = 65_535  # u16, as HELLO says the bias
Lineariser = Literal["board", "amplifier", "nothing"]
LINEARISERS: tuple[Lineariser, ...] = ("board", "amplifier", "nothing")
PEAK_S = 0.025  # from a click's beginning to its peak: 26 ms in the median of the bars' tables, 31 of the plate's


@dataclass(frozen=True)
class Electrodes:
    """How the force of an electrostatic actuator follows its voltage: one electrode or two opposed ones.

    bias: a fraction of the greatest voltage; phase_gap_deg: of the second electrode. The force of an electrode goes as
    the square of its voltage. About a bias b a swing d = min(b, 1 - b) stays between none and the greatest. A command
    a sin(wt) then gives

    - one electrode:       (b + d a sin wt)^2, a force 2 b d a and a second harmonic d^2 a^2 / 2: ratio d a / 4 b;
    - two, opposed, the second of them later by the phase gap p: (b + d a sin wt)^2 - (b + d a sin(wt + p))^2,
      a force 4 b d a |sin(p/2)| and a second harmonic d^2 a^2 |sin p|: ratio (d a / 2 b) |cos(p/2)|.

    So two electrodes half a turn apart are linear by themselves and have the greatest force, whatever the command. One
    electrode is linear if its voltage is the square root of b^2 + g s for a command s, with g = min(b^2, 1 - b^2): the
    core of the firmware does so (core/electrode.c). Without a bias the force has twice the frequency of the voltage.
    That the distance between electrode and mass changes as the actuator moves is left out: it is not published.
    """

    number: int
    bias: float
    phase_gap_deg: float
    linearised_by: Lineariser

    def second_harmonic(self, amplitude: float) -> float:
        """Amplitude of the force's second harmonic over that of the force itself, at an amplitude of the command."""
        if self.linearised_by != "nothing":
            return 0.0
        depth = min(self.bias, 1 - self.bias) * amplitude / self.bias
        if self.number == 1:
            return depth / 4
        return depth / 2 * abs(math.cos(math.radians(self.phase_gap_deg / 2)))

    @property
    def bias_word(self) -> int:
        """The bias as the firmware's `electrode_bias`, of the greatest voltage / 65535."""
        return round(_GREATEST_WORD * self.bias)


def board_bias(electrodes: Iterable[Electrodes | None]) -> int:
    """The `electrode_bias` of the board that drives these; 0 where it does not linearise."""
    return next((each.bias_word for each in electrodes if each and each.linearised_by == "board"), 0)


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

    kind: ClassVar = "bar"

    @property
    def corner_m(self) -> float:
        """The end of the bar: its points reach from 0 to here."""
        return self.length_m

    def wave_number_per_m(self, frequency_hz: float) -> float:
        """Wave number of free bending, (rho A omega^2 / E I)^(1/4)."""
        slowness = math.sqrt(12 * self.density_kg_per_m3 / self.youngs_modulus_pa)
        return math.sqrt(2 * math.pi * frequency_hz * slowness / self.thickness_m)


@dataclass(frozen=True)
class Plate:
    """A uniform rectangular Kirchhoff plate with free edges, with the damping of `Bar`; x runs along its length."""

    length_m: float
    width_m: float
    thickness_m: float
    youngs_modulus_pa: float
    density_kg_per_m3: float
    poissons_ratio: float
    mass_damping_per_s: float
    stiffness_damping_s: float
    damping_of: Literal["bar", "assembly"] = "bar"

    kind: ClassVar = "plate"

    @property
    def corner_m(self) -> complex:
        """The corner across from the first one: its points reach from 0 to here."""
        return complex(self.length_m, self.width_m)

    @property
    def bending_n_m(self) -> float:
        """Bending stiffness D = E h^3 / 12 (1 - nu^2)."""
        return self.youngs_modulus_pa * self.thickness_m**3 / (12 * (1 - self.poissons_ratio**2))

    def wave_number_per_m(self, frequency_hz: float) -> float:
        """Wave number of free bending, (rho h omega^2 / D)^(1/4)."""
        density_kg_per_m2 = self.density_kg_per_m3 * self.thickness_m
        return float((density_kg_per_m2 * (2 * math.pi * frequency_hz) ** 2 / self.bending_n_m) ** 0.25)


Surface = Bar | Plate  # what fingers touch


@dataclass(frozen=True)
class Actuator:
    """A spring and a damper between the surface and a base that is driven, or between it and a moving mass.

    Grounded: the base stands on the ground, as that of an electrostatic resonant actuator or a voice coil. Inertial: a
    moving mass takes the place of the base, as in a linear resonant actuator or an exciter. Full scale is a
    displacement in series with spring and damper, or, where `is_force`, a force beside them: full_scale_m is then that
    force divided by the stiffness.
    """

    name: str
    position_m: complex
    stiffness_n_per_m: float
    damping_n_s_per_m: float
    mass_kg: float
    full_scale_m: float
    band_hz: tuple[float, float]
    transfer: Transfer | None = None  # from a command to the displacement of the base; None: it moves as commanded
    electrodes: Electrodes | None = None  # how the force follows the voltage; None: the file does not say
    moving_mass_kg: float | None = None  # the mass that is not fixed to the surface; None: the actuator is grounded
    is_force: bool = False
    clamp_m: float = 0.0  # length of bar about its place that the bolts keep from bending
    delay_s: float = 0.0  # from a command to the base, beside the transfer function

    def clamped_m(self, length_m: float) -> tuple[float, float]:
        """Start and stop, m, of the rigid stretch about this actuator, cut off at the ends of a bar of `length_m`."""
        place_m = self.position_m.real
        return max(place_m - self.clamp_m / 2, 0.0), min(place_m + self.clamp_m / 2, length_m)

    @property
    def is_inertial(self) -> bool:
        """Whether spring and damper stand between the surface and a moving mass, not the ground."""
        return self.moving_mass_kg is not None

    @property
    def grounded_mass_kg(self) -> float:
        """The mass on the surface of a grounded actuator, 0 of an inertial one."""
        return 0.0 if self.is_inertial else self.mass_kg

    @property
    def spring_force_n(self) -> float:
        """Force at full scale on a surface, and a moving mass, that are held; without that of the damper."""
        return self.stiffness_n_per_m * self.full_scale_m

    @property
    def damper_force_n_s(self) -> float:
        """Force of the damper there, for each unit of the rate of the command; none where full scale is a force."""
        return 0.0 if self.is_force else self.damping_n_s_per_m * self.full_scale_m

    def scaled(self, stiffness: float, mass: float) -> "Actuator":
        """The actuator with its stiffness and its masses multiplied; a force at full scale stays as it is."""
        return replace(
            self,
            stiffness_n_per_m=self.stiffness_n_per_m * stiffness,
            mass_kg=self.mass_kg * mass,
            full_scale_m=self.full_scale_m / stiffness if self.is_force else self.full_scale_m,
            moving_mass_kg=None if self.moving_mass_kg is None else self.moving_mass_kg * mass,
        )


@dataclass(frozen=True)
class Zone:
    """A stretch of the bar, or a rectangle of the plate, that is felt, quiet or free as one; from corner to corner."""

    name: str
    start_m: complex
    stop_m: complex

    @property
    def length_m(self) -> float:
        """Length of the zone along the surface."""
        return (self.stop_m - self.start_m).real

    @property
    def middle_m(self) -> complex:
        """The point in its middle."""
        return (self.start_m + self.stop_m) / 2


@dataclass(frozen=True)
class Finger:
    """A grounded mass-damper-spring at the touch; `spread` is the factor by which its values vary, up and down."""

    mass_kg: float
    damping_n_s_per_m: float
    stiffness_n_per_m: float
    spread: float


@dataclass(frozen=True)
class Spread:
    """What is not known of a device and its fingers; clicks and drives are made for all of it.

    name: of the set of spreads, such as "bench"; empty: the device file's own. stiffness, mass: relative standard
    deviations (normal) of the surface and of every actuator; length: of the surface's sides; gain: of every channel.
    damping: standard deviation of the natural logarithm of the surface's damping, and of every actuator's. delay_s:
    each channel is early or late by up to this, evenly. clamp_m: bolts clamp up to this more of a bar than the file
    says, evenly. finger: mass, damping and stiffness vary evenly within plus and minus this fraction; None: log-
    normally, as people's do, 95 % of them within the factor `Finger.spread`. finger_position_m: a finger lies within
    this distance of where the digitizer tells, evenly on every axis; speed_m_per_s: its speed differs from what is told
    by up to this.
    """

    stiffness: float
    mass: float
    finger: float | None
    finger_position_m: float
    name: str = ""
    length: float = 0.0
    damping: float = 0.0
    gain: float = 0.0
    delay_s: float = 0.0
    clamp_m: float = 0.0
    speed_m_per_s: float = 0.0

    @property
    def reach_m(self) -> float:
        """How far a finger may lie from where it is taken to be when a click has its peak."""
        return self.finger_position_m + self.speed_m_per_s * PEAK_S

    @property
    def has_channels(self) -> bool:
        """Whether the channels differ from what the file says."""
        return self.gain > 0 or self.delay_s > 0

    @property
    def is_of_bars(self) -> bool:
        """Whether steady drives are made for other surfaces and channels too, and not for other fingers alone."""
        return self.has_channels or max(self.length, self.damping, self.clamp_m) > 0

    @property
    def stretch(self) -> float:
        """Relative standard deviation of all natural frequencies together, which go as sqrt(E / rho) / length^2."""
        return math.sqrt((self.stiffness**2 + self.mass**2) / 4 + (2 * self.length) ** 2)


@dataclass(frozen=True)
class TouchAcross:
    """How the digitizer lies across a plate, as `TouchAxis` says it along it."""

    flip: bool
    start_margin_m: float
    end_margin_m: float
    active_length_m: float | None


@dataclass(frozen=True)
class TouchAxis:
    """How the digitizer lies on the surface, along which axis and how far, and when its contacts have lifted.

    A negative margin: the touch area reaches beyond the surface, and a touch there counts as one at the edge.
    """

    axis: Literal["x", "y"]
    flip: bool
    start_margin_m: float
    end_margin_m: float
    active_length_m: float | None  # length of the touch area; None: it ends `end_margin_m` before the surface does
    silence_s: float | None = None  # time without a frame after which all contacts lift; None: as in the Linux kernel
    debounce_s: float = 0.0  # a contact that lifts for less than this time stays down
    latency_s: float = 0.0  # from the scan of a finger to its report
    across: "TouchAcross | None" = None  # on a plate: how it lies along the other axis, across the plate


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
    def frequency_hz(self) -> Array:
        """Shape (frequency,): `start_hz` to `stop_hz`, both included."""
        steps = round((self.stop_hz - self.start_hz) / self.step_hz)
        return np.linspace(self.start_hz, self.stop_hz, steps + 1)

    @property
    def amplitude(self) -> Array:
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
