"""A bench in virtual time: the emulated firmware, the surface in time, and a sensor with its converter. SIMULATED.

The bench is the port, the clock and the sensor of a measurement, so that the code that measures is the code of a real
one. Time passes only in `wait`; half an hour at the bar takes seconds. The converter has what real ones have, each of
it switchable: latency and its jitter, a clock that drifts, gain error, offset, noise, hum, clipping and lost samples.
"""

import math
import select
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from base.arrays import Array
from engine.device import Device
from engine.device.quantity import GRAVITY_M_PER_S2, QuantityError, read_words
from firmware_link.emulator.firmware import EmulatedFirmware
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.model.transfers import DelayFilter
from tactable.audio.simulated_card import SimulatedCard
from tactable.measure.sensor import ACCELERATION, LOOPBACK, Block, SensorError, SensorForm
from tactable.rig.accelerometer import EmulatedAccelerometer, SensedBoard, SensorPlant
from tactable.rig.emulate import configuration_of

PORT, SENSOR = -1, -2  # stand-ins for descriptors
_LINE_NS = 300_000  # between USB of high and of full speed (0.15 and 1 ms)


Board = EmulatedFirmware | SensedBoard | SimulatedCard  # a board without a line; times are microseconds of its own


class VirtualLine:
    """A board behind a line that takes _LINE_NS either way; what else wakes a wait is for its subclasses."""

    def __init__(self, board: Board) -> None:
        self.time_ns = _NS_PER_S
        self._board = board
        self._to_device: list[tuple[int, bytes]] = []
        self._to_host: list[tuple[int, bytes]] = []

    def now_ns(self) -> int:
        """Virtual time."""
        return self.time_ns

    def wait(self, until_ns: int | None, readable: Sequence[int], writable: Sequence[int]) -> Sequence[int]:  # noqa: ARG002  # a Clock
        """Let time pass until one of `readable` can be read, or until then."""
        end_ns = self.time_ns + _NS_PER_S if until_ns is None else until_ns
        while not (ready := self._ready_of(readable)) and self.time_ns < end_ns:
            self.run_to(min(end_ns, self._next_ns(readable)))
        return ready

    def fileno(self) -> int:
        """Stand-in for the port's descriptor."""
        return PORT

    def write(self, data: bytes) -> int:
        """Bytes for the firmware."""
        self._to_device.append((self.time_ns + _LINE_NS, data))
        return len(data)

    def read(self) -> bytes:
        """Bytes of the firmware."""
        data = b"".join(data for time_ns, data in self._to_host if time_ns <= self.time_ns)
        self._to_host = [item for item in self._to_host if item[0] > self.time_ns]
        return data

    def run_to(self, end_ns: int) -> None:
        """Let time pass."""
        while self._to_device and self._to_device[0][0] <= end_ns:
            time_ns, data = self._to_device.pop(0)
            self._answer(self._board.receive(data, time_ns // 1000), time_ns)
        self._answer(self._board.run_until(end_ns // 1000), end_ns)
        self.time_ns = end_ns

    def _answer(self, data: bytes, time_ns: int) -> None:
        if data:
            self._to_host.append((time_ns + _LINE_NS, data))

    def _ready_of(self, readable: Sequence[int]) -> list[int]:
        """The stand-in of the port where something has come, and every real descriptor that can be read."""
        found = [PORT] if any(time_ns <= self.time_ns for time_ns, _ in self._to_host) else []
        real = [descriptor for descriptor in readable if descriptor >= 0]
        if real:
            found += select.select(real, [], [], 0)[0]
        return [descriptor for descriptor in found if descriptor in readable]

    def _next_ns(self, readable: Sequence[int]) -> int:  # noqa: ARG002  # for subclasses
        """Time at which a byte arrives or the board acts by itself next."""
        times_ns = [time_ns for time_ns, _ in (*self._to_device, *self._to_host)]
        deadline_us = self._board.next_deadline_us()
        if deadline_us is not None:
            times_ns.append(1000 * deadline_us)
        return max(self.time_ns + 1, min(times_ns, default=self.time_ns + _NS_PER_S))


BOOT_ID = 0x5EED
MOVING_NS = 500_000_000  # a hand takes longer; a bar rings for 24 to 878 ms (docs/theory.md)
_BLOCK_S = 0.05  # in which samples come; the bar is moved a block at a time
_PLANT_HZ, _FINE_HZ, FINE_MODES = 24_000.0, 48_000.0, 96  # straight lines at 24 kHz: 5e-4 of 300 Hz, 0.005 dB
_DROP_S = 0.003  # of samples that are lost at once
_NS_PER_S = 1_000_000_000
_US_PER_S = 1e6


@dataclass(frozen=True)
class ConverterFlaws:
    """The flaws of a simulated converter.

    drift: pace of its clock over the board's, less 1. gain: less 1. noise: root mean square. hum: amplitude of the
    mains line at hum_hz, with a third of it at the third harmonic. clips_at: greatest magnitude of the acceleration.
    drops_per_s: how often samples are lost without a trace. late_s: delay of the last actuator's
    output. stalls_at_s: from when on the sensor repeats its value.
    has_gravity: the sensor lies level and shows gravity, as sensors that pass direct current do.
    """

    latency_s: float = 0.008
    jitter_s: float = 0.0
    drift: float = 0.0
    gain: float = 0.0
    offset_m_per_s2: float = 0.0
    noise_m_per_s2: float = 0.0
    hum_m_per_s2: float = 0.0
    hum_hz: float = 50.0
    clips_at_m_per_s2: float = math.inf
    drops_per_s: float = 0.0
    stalls_at_s: float = math.inf
    late_s: float = 0.0
    has_gravity: bool = False

    @classmethod
    def parse(cls, text: str) -> "ConverterFlaws":
        """The flaws of a text such as "noise=0.05 m/s^2, drift=40, latency=12ms"; drift in millionths, gain in %.

        Raises SensorError, which names the word and the known ones.
        """
        try:
            return replace(cls(), **read_words(text, _WORDS))
        except QuantityError as error:
            raise SensorError(f"flaw {error}") from None


_WORDS = {
    "latency": ("latency_s", "s"),
    "jitter": ("jitter_s", "s"),
    "late": ("late_s", "s"),
    "drift": ("drift", "ppm"),
    "gain": ("gain", ""),
    "offset": ("offset_m_per_s2", "m/s^2"),
    "noise": ("noise_m_per_s2", "m/s^2"),
    "hum": ("hum_m_per_s2", "m/s^2"),
    "mains": ("hum_hz", "Hz"),
    "clip": ("clips_at_m_per_s2", "m/s^2"),
    "drops": ("drops_per_s", "number"),
    "stall": ("stalls_at_s", "s"),
}
assert {name for name, _ in _WORDS.values()} <= {field.name for field in fields(ConverterFlaws)}


class Converter:
    """The samples that a converter with its flaws makes of the acceleration of a sensor and of what drives the bar."""

    def __init__(self, flaws: ConverterFlaws, form: SensorForm, has_sum: bool, random: np.random.Generator) -> None:
        self._flaws, self._form, self._has_sum, self._random = flaws, form, has_sum, random
        self._last_m_per_s2 = 0.0

    def latency_s(self) -> float:
        """How late the next block comes."""
        return max(0.0, self._flaws.latency_s + self._flaws.jitter_s * self._random.standard_normal())

    def convert(self, acceleration: Array, drive: Array, time_s: Array) -> Array:
        """Samples (sample, channel) of an acceleration (sample,) and displacements (sample, actuator)."""
        flaws, random, turns = self._flaws, self._random, 2 * np.pi * self._flaws.hum_hz * time_s
        out = acceleration * (1 + flaws.gain) + flaws.offset_m_per_s2
        out += flaws.hum_m_per_s2 * (np.sin(turns) + np.sin(3 * turns) / 3)
        out += flaws.noise_m_per_s2 * random.standard_normal(len(out))
        if time_s[0] >= flaws.stalls_at_s:
            out[:] = self._last_m_per_s2
        self._last_m_per_s2 = float(out[-1])
        out = np.clip(out, -flaws.clips_at_m_per_s2, flaws.clips_at_m_per_s2)
        heard = np.repeat(drive.sum(axis=1, keepdims=True), drive.shape[1], axis=1) if self._has_sum else drive
        values = np.column_stack([out, *heard.T[: len(self._form.channels) - 1]])
        if random.random() >= flaws.drops_per_s * _BLOCK_S:
            return values
        lost = min(len(values), round(_DROP_S * self._form.sample_rate_hz))
        start = int(random.integers(0, len(values) - lost + 1))
        return np.delete(values, slice(start, start + lost), axis=0)


class SimulatedBench(VirtualLine):
    """Port, clock and sensor of the surface `true`, of whose actuators `board` says the full scales. SIMULATED.

    The board is an emulated firmware, or `card`. With `has_sum` one loopback channel has the outputs of all actuators,
    and is that of each. Raises AccelerometerError for a place beside it.
    """

    def __init__(
        self,
        true: Device,
        flaws: ConverterFlaws,
        seed: int,
        sensor_mass_kg: float = 2e-3,
        sample_rate_hz: float = 8_000.0,
        board: Device | None = None,
        has_loopback: bool = True,
        is_fine: bool = False,
        card: SimulatedCard | None = None,
        has_sum: bool = False,
    ) -> None:
        own_m = [actuator.full_scale_m for actuator in (board or true).actuators]
        self.firmware = EmulatedFirmware(configuration_of(board or true, BOOT_ID))
        self.card = card
        super().__init__(card or self.firmware)
        self._of_card = [] if card is None else np.divide(card.output.full_scales_m[: len(own_m)], own_m)
        loopbacks = tuple(LOOPBACK + a.name for a in true.actuators) if has_loopback else ()
        clips_at = (flaws.clips_at_m_per_s2, *(math.inf for _ in loopbacks))
        self.form = SensorForm(sample_rate_hz, (ACCELERATION, *loopbacks), clips_at, is_simulated=True)
        self._converter = Converter(flaws, self.form, has_sum, np.random.default_rng(seed))
        self._gravity_m_per_s2 = flaws.has_gravity * GRAVITY_M_PER_S2
        self._plant_samples = math.ceil((_FINE_HZ if is_fine else _PLANT_HZ) / sample_rate_hz)
        basis = compute_basis(assemble(true), FINE_MODES if is_fine else None)
        plant_hz = sample_rate_hz * (1 + flaws.drift) * self._plant_samples
        self._plant = SensorPlant(true, basis, plant_hz, sensor_mass_kg)
        self._late = DelayFilter(flaws.late_s, plant_hz) if flaws.late_s else None
        self._ready: list[tuple[int, Array]] = []
        self._made_us = 0.0
        self.place(true.surface.corner_m / 2)

    def place(self, position_m: complex) -> None:
        """Put the sensor here; that takes as long as the surface takes to come to rest."""
        self.run_to(self.time_ns + MOVING_NS)
        self._make_samples()
        self._plant.place(position_m)

    def turn_over(self) -> None:
        """Turn the sensor over, so that gravity shows with the other sign."""
        self._make_samples()
        self._plant.turn_over()

    def _ready_of(self, readable: Sequence[int]) -> list[int]:
        found = super()._ready_of(readable)
        if SENSOR in readable:
            self._make_samples()
            found += [SENSOR for time_ns, _ in self._ready[:1] if time_ns <= self.time_ns]
        return found

    def _next_ns(self, readable: Sequence[int]) -> int:
        time_ns = super()._next_ns(readable)
        if SENSOR not in readable:
            return time_ns
        block_ns = self._ready[0][0] if self._ready else self.time_ns + int(_BLOCK_S * _NS_PER_S)
        return max(self.time_ns + 1, min(time_ns, block_ns))

    def take_samples(self) -> Array | None:
        """The samples that have come (sample, channel), or None if none have."""
        self._make_samples()
        due = [values for time_ns, values in self._ready if time_ns <= self.time_ns]
        self._ready = [item for item in self._ready if item[0] > self.time_ns]
        return np.concatenate(due) if due else None

    def _make_samples(self) -> None:
        """Run bar and converter up to now, block by block; a block arrives after the latency."""
        while self._made_us + _BLOCK_S * _US_PER_S <= self.time_ns / 1000:
            stop_us = self._made_us + _BLOCK_S * _US_PER_S
            values = self._sense(self._made_us, stop_us)
            arrives_ns = int(1000 * stop_us + self._converter.latency_s() * _NS_PER_S)
            # A block never overtakes the one before.
            self._ready.append((max([arrives_ns, *(time_ns for time_ns, _ in self._ready[-1:])]), values))
            if self.card is not None:
                self.card.forget(stop_us)
            self._made_us = stop_us

    def _sense(self, start_us: float, stop_us: float) -> Array:
        """Samples (sample, channel) of a stretch of time, as the converter delivers them."""
        plant, rate_hz = self._plant, self._plant.sample_rate_hz
        if self.card is not None:
            drive = self.card.drive(start_us, stop_us, rate_hz)[:, : len(self._of_card)] * self._of_card
        else:
            drive = plant.drive(self.firmware.drive_log, start_us, stop_us)
        if self._late is not None:
            drive = np.column_stack([drive[:, :-1], self._late.run(drive[:, -1])])
        felt, index = plant.move(drive, start_us)
        felt += plant.sign * self._gravity_m_per_s2
        kept = index % self._plant_samples == 0
        return self._converter.convert(felt[kept], drive[kept], index[kept] / rate_hz)


class SimulatedSensor:
    """The sensor of a bench, behind the interface of all sensors."""

    def __init__(self, bench: SimulatedBench) -> None:
        self._bench, self.form = bench, bench.form

    def fileno(self) -> int:
        """Stand-in for a descriptor."""
        return SENSOR

    def read(self) -> Block | None:
        """The samples that have come (sample, channel), or None if none have."""
        values = self._bench.take_samples()
        return None if values is None else Block(values, self._bench.now_ns())

    def pace(self) -> float:
        """Nothing is known of the converter's clock before a tone is read."""
        return 0.0

    def close(self) -> None:
        """Nothing is open."""


_OF_CONVERTERS = {"hum_m_per_s2": "hum", "drops_per_s": "drops", "jitter_s": "jitter"}


class BoardBench(VirtualLine):
    """Port, clock and person at the surface `true`, of whose actuators `board` says the full scales. SIMULATED.

    Raises SensorError for flaws that an accelerometer on the board cannot have, AccelerometerError for a place beside
    it.
    """

    def __init__(
        self,
        true: Device,
        flaws: ConverterFlaws,
        seed: int,
        sensor_mass_kg: float,
        board: Device | None = None,
        *,
        is_fine: bool = False,
    ) -> None:
        for name, flaw in _OF_CONVERTERS.items():
            if getattr(flaws, name):
                raise SensorError(f"--flaws {flaw}: is of a converter, and the board's own accelerometer has none")
        kept = (flaws.drift, flaws.gain, flaws.offset_m_per_s2, flaws.noise_m_per_s2)
        part = EmulatedAccelerometer(true.surface.corner_m / 2, sensor_mass_kg, *kept)
        basis = compute_basis(assemble(true), FINE_MODES if is_fine else None)
        self._sensed = SensedBoard(configuration_of(board or true, BOOT_ID), true, part, seed, basis)
        self.firmware = self._sensed.core
        super().__init__(self._sensed)

    def place(self, position_m: complex) -> None:
        """Put the sensor here; that takes as long as the surface takes to come to rest."""
        self.run_to(self.time_ns + MOVING_NS)
        self._sensed.plant.place(position_m)

    def turn_over(self) -> None:
        """Turn the sensor over, so that gravity shows with the other sign."""
        self._sensed.plant.turn_over()
