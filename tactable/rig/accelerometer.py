"""The board's accelerometer on the simulated surface: a firmware core with samples of what moves under its drive.

SIMULATED. The part is an ADXL345 at 3200 samples a second, by its data sheet (revision E): 256 counts per g in full
resolution, whose last bit is always 0 at this rate, a range of 16 g, and across the chip 1.1 counts of noise at 100
samples a second, which is white and so grows with the root of the rate. `quiet` makes it one like an ADXL355, by its
data sheet: 25 ug/sqrt(Hz), a range of 2 g of which the upper 16 bits are read. Its oscillator is its own. It passes
direct current: lying level it shows gravity.

Theory of operation. Time passes in blocks. The core is advanced to the end of a block; then its drive within the block
is known, the surface is moved by it, and the samples are handed to the core with the displacements of their instants,
as the interrupt of a board would have done. While nobody asks for samples the surface stands still and costs nothing.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from base.arrays import Array, Integers
from base.errors import TactableError
from base.points import is_within, point_text
from engine.device import Device
from engine.device.quantity import GRAVITY_M_PER_S2, QuantityError, read_words
from firmware_link.emulator.device_state import DeviceConfiguration, DeviceCounters
from firmware_link.emulator.drive_log import DriveEvent
from firmware_link.emulator.firmware import EmulatedFirmware
from firmware_link.emulator.synthesis import Synthesis
from firmware_link.protocol.basis import SAMPLE_FULL_SCALE
from firmware_link.protocol.framing import FramingCounters
from precompute.model.assembly import assemble
from precompute.model.modal import Basis, compute_basis
from precompute.model.transient import TransientPlant

RATE_HZ = 3_200.0  # its fastest, see above
SCALE_M_PER_S2 = GRAVITY_M_PER_S2 / 256
GREATEST, STEP = 4_095, 2  # 13 bits for 16 g; the last bit is 0
NOISE_M_PER_S2 = 1.1 * SCALE_M_PER_S2 * math.sqrt(RATE_HZ / 100)
QUIET_SCALE_M_PER_S2, QUIET_GREATEST = 2 * GRAVITY_M_PER_S2 / 32_768, 32_767
QUIET_NOISE_M_PER_S2 = 25e-6 * GRAVITY_M_PER_S2 * math.sqrt(RATE_HZ / 2)
_PLANT_SAMPLES = 8
"""Samples of the plant in one of the accelerometer: 25.6 kHz, at which straight lines cost 0.005 dB of 300 Hz."""
_BLOCK_US = 10_000  # a full frame of two actuators, 32 samples
_US_PER_S = 1_000_000


class AccelerometerError(TactableError, ValueError):
    """The text of an accelerometer cannot be read; the message names the word and the known ones."""


@dataclass(frozen=True)
class EmulatedAccelerometer:
    """Place of the part, and its deviations from its data sheet.

    drift: pace of its oscillator over the nominal one, less 1. gain: less 1. noise: root mean square, beside that of
    the part. quiet: 1 for the quiet part, see above. finger_m: where a standard finger rests all the time, or None.
    """

    at_m: complex
    mass_kg: float = 2e-3
    drift: float = 0.0
    gain: float = 0.0
    offset_m_per_s2: float = 0.0
    noise_m_per_s2: float = 0.0
    quiet: float = 0.0
    finger_m: complex | None = None

    @property
    def scale_m_per_s2(self) -> float:
        """Acceleration of a count."""
        return QUIET_SCALE_M_PER_S2 if self.quiet else SCALE_M_PER_S2

    @classmethod
    def parse(cls, text: str) -> "EmulatedAccelerometer":
        """One of a text such as "at=35 mm, mass=2 g, drift=12000", on a plate "at=35 x 60 mm"; drift in millionths.

        Raises AccelerometerError.
        """
        try:
            found = read_words(text, _WORDS)
        except QuantityError as error:
            raise AccelerometerError(f"accelerometer: {error}") from None
        if "at_m" not in found:
            raise AccelerometerError("accelerometer: says no place; give at=35mm, or on a plate at=35x60mm")
        return cls(**found)


_WORDS = {
    "at": ("at_m", "point"),
    "mass": ("mass_kg", "kg"),
    "drift": ("drift", "ppm"),
    "gain": ("gain", ""),
    "offset": ("offset_m_per_s2", "m/s^2"),
    "noise": ("noise_m_per_s2", "m/s^2"),
    "quiet": ("quiet", "number"),
    "finger": ("finger_m", "point"),
}
assert [name for name, _ in _WORDS.values()] == [field.name for field in fields(EmulatedAccelerometer)]


class SensorPlant:
    """The surface of a device in time, a sensor of a mass on it, moved by the drive of a firmware's log. SIMULATED.

    finger_m: where a standard finger rests all the time, or None. `sign` is -1 while the sensor is turned over.
    """

    def __init__(
        self, device: Device, basis: Basis, sample_rate_hz: float, mass_kg: float, finger_m: complex | None = None
    ) -> None:
        self.device, self._mass_kg, self._finger_m = device, mass_kg, finger_m
        self._plant = TransientPlant(basis, np.zeros(1), sample_rate_hz)
        self._synthesis, self._taken = Synthesis(), 0
        self.sample_rate_hz, self.sign = sample_rate_hz, 1.0

    def place(self, position_m: complex) -> None:
        """Put the sensor here; the surface comes to rest meanwhile. Raises AccelerometerError for a place off it."""
        kind, corner_m, finger = self.device.surface.kind, self.device.surface.corner_m, self.device.finger
        lying = [] if self._finger_m is None else [(self._finger_m, finger)]
        for at_m in (position_m, *(at_m for at_m, _ in lying)):
            if not is_within(at_m, corner_m) or isinstance(at_m, complex) != isinstance(corner_m, complex):
                text, size = point_text(at_m), point_text(corner_m)
                raise AccelerometerError(f"{text} is off the {kind} of {size}; put it on the {kind}")
        weight = {"mass_kg": self._mass_kg, "damping_n_s_per_m": 0.0, "stiffness_n_per_m": 0.0}
        self._plant.rest()
        self._plant.look_at(np.array([position_m]))
        self._plant.touch([(position_m, replace(finger, **weight)), *lying])

    def turn_over(self) -> None:
        """Turn the sensor over: what it reads changes its sign."""
        self.sign = -self.sign

    def drive(self, log: Sequence[DriveEvent], start_us: float, stop_us: float) -> Array:
        """Displacements (sample, actuator) of the next stretch of time, by a log that grows; what was before goes."""
        self._synthesis.take_events(log[self._taken :])
        self._taken = len(log)
        drive = self._synthesis.displacements(start_us, stop_us, self.sample_rate_hz)
        self._synthesis.forget(stop_us)
        # Without any event there are no actuators.
        return drive if drive.shape[1] else np.zeros((len(drive), len(self.device.actuators)))

    def move(self, drive: Array, start_us: float) -> tuple[Array, Integers]:
        """What the sensor feels (sample,) of displacements from a time on, less gravity; the numbers of its samples."""
        index = math.ceil(start_us * self.sample_rate_hz / _US_PER_S) + np.arange(len(drive))
        return self.sign * self._plant.accelerate(drive)[:, 0], index


class SensedSurface:
    """Boots boards whose accelerometer lies on one surface, the modes of which are computed once."""

    def __init__(self, device: Device, accelerometer: EmulatedAccelerometer, seed: int) -> None:
        self._device, self._accelerometer, self._seed = device, accelerometer, seed
        self._basis = compute_basis(assemble(device))
        self.boot(DeviceConfiguration(0, len(device.actuators)))  # a place off the surface is refused now

    def boot(self, configuration: DeviceConfiguration) -> "SensedBoard":
        """A board that has just booted; the surface is at rest. Raises AccelerometerError for a place off it."""
        return SensedBoard(configuration, self._device, self._accelerometer, self._seed, self._basis)


class SensedBoard:
    """A core whose accelerometer lies on the simulated surface; used like the core itself, see `FaultyDevice`.

    Raises AccelerometerError for a place off the surface.
    """

    def __init__(
        self,
        configuration: DeviceConfiguration,
        device: Device,
        accelerometer: EmulatedAccelerometer,
        seed: int,
        basis: Basis | None = None,
    ) -> None:
        self.configuration = replace(
            configuration,
            sensor_rate_mhz=round(1_000 * RATE_HZ),
            sensor_scale_nm_per_s2=round(1e9 * accelerometer.scale_m_per_s2),
            sensor_greatest=QUIET_GREATEST if accelerometer.quiet else GREATEST,
        )
        self.core = EmulatedFirmware(self.configuration)
        self._part, self._random = accelerometer, np.random.default_rng(seed)
        plant_hz = RATE_HZ * (1 + accelerometer.drift) * _PLANT_SAMPLES
        modes = basis or compute_basis(assemble(device))
        self.plant = SensorPlant(device, modes, plant_hz, accelerometer.mass_kg, accelerometer.finger_m)
        self._made_us: int | None = None
        self.plant.place(accelerometer.at_m)

    @property
    def counters(self) -> DeviceCounters:
        """Counters of the core since boot."""
        return self.core.counters

    @property
    def framing_counters(self) -> FramingCounters:
        """Frames accepted and refused since boot."""
        return self.core.framing_counters

    def receive(self, data: bytes, now_us: int) -> bytes:
        """Take bytes that came at `now_us`; returns what the device sends until then."""
        return self._pass(now_us) + self.core.receive(data, now_us)

    def run_until(self, now_us: int) -> bytes:
        """Let time pass up to `now_us`; returns what the device sends until then."""
        return self._pass(now_us) + self.core.run_until(now_us)

    def hang_up(self, now_us: int) -> bytes:
        """The host let go of the line; returns what the device sends until then."""
        return self._pass(now_us) + self.core.hang_up(now_us)

    def next_deadline_us(self) -> int | None:
        """When the device or its accelerometer acts by itself next; None while both wait."""
        own_us = self.core.next_deadline_us()
        if self._made_us is None:
            return own_us
        block_us = self._made_us + _BLOCK_US
        return block_us if own_us is None else min(own_us, block_us)

    def _pass(self, now_us: int) -> bytes:
        """Sample the surface up to now, block by block, and send what is whole."""
        said = b""
        if not self.core.senses:
            self._made_us = None
            return said
        if self._made_us is None:
            self._made_us = now_us
        while self._made_us + _BLOCK_US <= now_us and self.core.senses:
            stop_us = self._made_us + _BLOCK_US
            said += self.core.run_until(stop_us)
            self._sense(self._made_us, stop_us)
            self._made_us = stop_us
        return said

    def _sense(self, start_us: int, stop_us: int) -> None:
        """Hand the samples of a block to the core."""
        drive = self.plant.drive(self.core.drive_log, start_us, stop_us)
        felt, index = self.plant.move(drive, start_us)
        kept = index % _PLANT_SAMPLES == 0
        counts = self._counts(felt[kept])
        spare = self.configuration.number_of_actuators - drive.shape[1]
        displacements = np.pad(np.rint(SAMPLE_FULL_SCALE * drive[kept]).astype(int), ((0, 0), (0, spare)))
        instants = index[kept] * self.configuration.synthesis_rate_hz // self.plant.sample_rate_hz
        for count, row, instant in zip(counts.tolist(), displacements.tolist(), instants.tolist(), strict=True):
            self.core.sense(count, row, int(instant))

    def _counts(self, acceleration: Array) -> Integers:
        """Counts of the part for accelerations (sample,) in m/s^2."""
        part = self._part
        own, step, most = (QUIET_NOISE_M_PER_S2, 1, QUIET_GREATEST) if part.quiet else (NOISE_M_PER_S2, STEP, GREATEST)
        noise = math.hypot(own, part.noise_m_per_s2) * self._random.standard_normal(len(acceleration))
        read = (acceleration + self.plant.sign * GRAVITY_M_PER_S2) * (1 + part.gain) + part.offset_m_per_s2 + noise
        counts: Integers = step * np.rint(read / (step * part.scale_m_per_s2)).astype(np.int64)
        return np.clip(counts, -most, most)
