"""The board's own accelerometer as a sensor: samples of the link, with the displacement of every actuator beside them.

Theory of operation. The board takes both columns of a record at one instant, so that the displacements are loopback
channels without a converter: a response is their ratio, and neither latency nor the line has a part in it. What the
line or the board lost shows as a gap of the numbers, and becomes samples that are known to be lost. The accelerometer
has an oscillator of its own, a percent off on some parts; how fast it runs beside the board's clock is read from the
two numbers that every frame carries.
"""

import os
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from base.arrays import Array
from engine.device import Device
from engine.device.quantity import QuantityError, read_point_on
from engine.loop.loop import Clock
from firmware_link.host.link_values import BOARD_EMULATED, AccelerometerDescribed, Capabilities, Event
from firmware_link.host.session import Port
from firmware_link.protocol.basis import SAMPLE_FULL_SCALE
from firmware_link.protocol.messages import Acceleration
from tactable.measure.driven_device import DrivenDevice
from tactable.measure.sensor import ACCELERATION, LOOPBACK, Block, SensorError, SensorForm

NAME = "board"
PROBE_S = 0.5  # half of it is the least for a pace: 0.1 ms of jitter are then 400 ppm
_PATIENCE_S = 2.0
_PACE_S = 10.0  # of frames whose pace is taken: 0.1 ms of jitter are then 10 ppm
_LONGEST_GAP_S = 1.0
_WRAP_16, _WRAP_32 = 1 << 16, 1 << 32  # where the counters of ACCELERATION wrap
_NS_PER_S = 1_000_000_000


def is_board(name: str) -> bool:
    """Whether the name of a sensor means the board's own, at a place or guided over the surface."""
    return name == NAME or name.startswith(f"{NAME}:")


def fixed_position_m(name: str, device: Device) -> complex | None:
    """Point of a fixed sensor, "board:35mm", "board:25%", "board:35x60mm"; None for a moved one. Raises SensorError."""
    _, _, text = name.partition(":")
    if name == NAME or not is_board(name):
        return None
    try:
        return read_point_on(text, device.surface.corner_m)
    except QuantityError as error:
        raise SensorError(f"--sensor {name}: {error}") from None


def fixed_places(device: Device, name: str, places_m: list[complex]) -> list[complex]:
    """The points of a walk, or the one of a sensor that is fixed. Raises SensorError."""
    fixed_m = fixed_position_m(name, device)
    return places_m if fixed_m is None else [fixed_m]


@dataclass
class Losses:
    """Frames that the line lost, and samples that the board lost or did not read, since the sensor was opened."""

    frames: int = 0
    samples: int = 0


class BoardSensor:
    """The accelerometer that a board described; a `DrivenDevice` hands it what the link heard."""

    def __init__(
        self, part: AccelerometerDescribed, device: Device, board: Capabilities, scales: Sequence[float], clock: Clock
    ) -> None:
        names = [actuator.name for actuator in device.actuators]
        greatest_m_per_s2 = part.greatest * part.scale_m_per_s2
        channels = (ACCELERATION, *(LOOPBACK + name for name in names))
        clips_at = (greatest_m_per_s2, *(np.inf for _ in names))
        self.form = SensorForm(part.rate_hz, channels, clips_at, board.board == BOARD_EMULATED)
        self.losses = Losses()
        self._clock, self._synthesis_rate_hz = clock, board.synthesis_rate_hz
        self._values = 1 + board.number_of_actuators
        # Amplitudes were multiplied by the scales on their way to the board.
        self._units = np.array([part.scale_m_per_s2, *(1 / (SAMPLE_FULL_SCALE * scale) for scale in scales)])
        self._signal = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._waiting: list[Array] = []
        self._points: deque[tuple[int, int]] = deque()
        self._last: Acceleration | None = None

    def fileno(self) -> int:
        """The descriptor, to poll."""
        return self._signal

    def begin_stream(self) -> None:
        """A stream begins; what came before does not belong to it."""
        self._last = None
        self._points.clear()

    def take_event(self, event: Event) -> None:
        """Take an event of the link."""
        if isinstance(event, Acceleration):
            self._take_frame(event)

    def read(self) -> Block | None:
        """New samples, or None."""
        if not self._waiting:
            return None
        os.eventfd_read(self._signal)
        values, self._waiting = np.concatenate(self._waiting), []
        return Block(values, self._clock.now_ns())

    def pace(self) -> float:
        """The pace of the accelerometer's clock over the board's, less 1; 0 until enough has come."""
        if len(self._points) < 2:
            return 0.0
        number, sample = (np.array(column, dtype=float) for column in zip(*self._points, strict=True))
        if np.ptp(sample) < PROBE_S / 2 * self._synthesis_rate_hz:
            return 0.0
        slope = np.polyfit(sample - sample[0], number - number[0], 1)[0]
        return float(slope * self._synthesis_rate_hz / self.form.sample_rate_hz - 1)

    def close(self) -> None:
        """Close the descriptor."""
        os.close(self._signal)

    def _take_frame(self, frame: Acceleration) -> None:
        count = len(frame.values) // self._values
        if not count:
            return
        lost = self._count_losses(frame)
        raw = np.array(frame.values[: count * self._values], float).reshape(count, self._values)
        rows = raw[:, : len(self._units)] * self._units
        # A long gap needs no mark for every sample: what follows does not continue what came before.
        marks = min(lost, round(_LONGEST_GAP_S * self.form.sample_rate_hz))
        if not self._waiting:
            os.eventfd_write(self._signal, 1)
        self._waiting.append(np.vstack([np.full((marks, len(self._units)), np.nan), rows]))
        self._note_pace(frame)
        self._last = frame

    def _count_losses(self, frame: Acceleration) -> int:
        """Samples that are missing before this frame."""
        last = self._last
        if last is None:
            return 0
        lost = (frame.number - last.number - len(last.values) // self._values) % _WRAP_32
        frames = (frame.frame - last.frame - 1) % _WRAP_16
        self.losses.frames += frames
        # A gap without a missing frame was on the board.
        self.losses.samples += 0 if frames else lost
        return lost

    def _note_pace(self, frame: Acceleration) -> None:
        number, sample = frame.number, frame.synthesis_sample
        if self._points:
            before_number, before_sample = self._points[-1]
            number = before_number + (number - before_number) % _WRAP_32
            sample = before_sample + (sample - before_sample) % _WRAP_32
        self._points.append((number, sample))
        while sample - self._points[0][1] > _PACE_S * self._synthesis_rate_hz:
            self._points.popleft()


class _Probe:
    """Takes the description of a board's accelerometer, before there is a sensor."""

    described: AccelerometerDescribed | None = None

    def begin_stream(self) -> None:
        """Nothing to forget."""

    def take_event(self, event: Event) -> None:
        """Take an event of the link."""
        if isinstance(event, AccelerometerDescribed):
            self.described = event


def open_board_sensor(device: Device, port: Port, clock: Clock, bit_rate_hz: int) -> BoardSensor:
    """The accelerometer of the board at a port, which is armed for no amplitude meanwhile.

    Raises LinkError for a board without one and for a line that is too slow, SensorError for one that says nothing.
    """
    probe = _Probe()
    with DrivenDevice(device, port, clock, [0.0] * len(device.actuators), bit_rate_hz, accelerometer=probe) as driven:
        end_ns = clock.now_ns() + int(_PATIENCE_S * _NS_PER_S)
        while probe.described is None and clock.now_ns() < end_ns:
            driven.wait(clock.now_ns() + _NS_PER_S // 20)
    if probe.described is None:
        raise SensorError("the board's accelerometer does not answer: check its wiring, then reset the board")
    return BoardSensor(probe.described, device, driven.capabilities, driven.fit.scales, clock)
