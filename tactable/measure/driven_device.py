"""One armed device that plays the drives it is told, for as long as `wait` is called, and then falls silent.

Theory of operation. The lease of a drive is renewed only inside `wait`, by the same link as in a run, so that a program
that hangs renews nothing and the board falls silent by itself. ARM carries the greatest amplitude that will be asked
for, so that the board refuses more whatever this program does. Leaving the `with` block ramps to zero and latches the
board by STOP, whether the block ended by itself, by an error or by Ctrl-C.

A table's drive is scaled down to the limits (`engine.render.limits.clamp`), since its pattern is what counts. A drive
that a person or a measurement asked for by its numbers is refused beyond them instead: a bar that plays something else
would be measured wrongly.
"""

import cmath
import contextlib
from collections.abc import Container, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from base.arrays import Array, Complex, Points
from engine.device import Device
from engine.loop.loop import Clock, Listener, connect
from engine.render.board_fit import check_frequencies, choose_basis, fit_board, scaled
from engine.render.limits import Drive, LimitError, clamp, encode_scaled, link_configuration
from firmware_link import BIT_RATE_HZ
from firmware_link.host.link import Link
from firmware_link.host.link_values import BOARD_EMULATED, LinkConfiguration, LinkState
from firmware_link.host.session import Port, Session
from firmware_link.protocol.basis import Basis
from firmware_link.protocol.link_errors import LinkError
from firmware_link.protocol.messages import Fault, Status
from precompute.model.assembly import assemble
from tactable.measure.sensor import Sensor, SensorError

_BLOCKED_LINE_NS = 5_000_000  # a line that takes nothing is tried again this often
_NS_PER_US = 1_000
_ROUNDING = 1e-9


@dataclass(frozen=True)
class AskedDrive:
    """Frequency in Hz, amplitude as a fraction of full scale and phase by actuator; amplitude 0 is a still actuator."""

    frequencies_hz: tuple[float, ...]
    amplitudes: tuple[float, ...]
    phases_rad: tuple[float, ...]

    @property
    def phasors(self) -> Complex:
        """Shape (actuator,): amplitudes with their phases, fractions of full scale."""
        pairs = zip(self.amplitudes, self.phases_rad, strict=True)
        return np.array([cmath.rect(amplitude, phase_rad) for amplitude, phase_rad in pairs])

    @property
    def frequency_hz(self) -> float:
        """The frequency of the strongest actuator."""
        return self.frequencies_hz[int(np.argmax(self.amplitudes))]

    @property
    def tones(self) -> "list[AskedDrive]":
        """Its parts of one frequency each; the actuators of other parts are still."""
        channels = list(zip(self.frequencies_hz, self.amplitudes, strict=True))
        return [
            replace(self, amplitudes=tuple(size * (own_hz == hz) for own_hz, size in channels))
            for hz in dict.fromkeys(hz for hz, size in channels if size)
        ]

    @classmethod
    def of_one(cls, device: Device, actuator: int, frequency_hz: float, amplitude: float) -> "AskedDrive":
        """One actuator (its index) alone at phase 0."""
        count = range(len(device.actuators))
        amplitudes = tuple(amplitude if i == actuator else 0.0 for i in count)
        return cls((frequency_hz,) * len(count), amplitudes, (0.0,) * len(count))


def check_drive(asked: AskedDrive, device: Device) -> Drive:
    """The drive within the device's limits; raises LimitError, which names actuator, value and limit, beyond them."""
    limit = device.limits.amplitude
    for actuator, hz, amplitude in zip(device.actuators, asked.frequencies_hz, asked.amplitudes, strict=True):
        low_hz, high_hz = actuator.band_hz
        if amplitude > 0 and not low_hz <= hz <= high_hz:
            raise LimitError(
                f"actuator {actuator.name}: {hz:g} Hz is outside its band; ask for {low_hz:g} to {high_hz:g} Hz, or "
                "widen `band` in the device file if the actuator bears it"
            )
        if not 0 <= amplitude <= limit * (1 + _ROUNDING):
            raise LimitError(
                f"actuator {actuator.name}: an amplitude of {100 * amplitude:g} % is beyond limits.amplitude of "
                f"{device.name}; ask for 0 to {100 * limit:g} % of full scale"
            )
    return clamp(asked, device)


def simulate_levels(device: Device, asked: AskedDrive, position_m: Points) -> tuple[Array, Array]:
    """Peaks (point,) in m/s^2 and levels (point,) in dB above the threshold under a held drive, at points in metres.

    The surface is untouched. Tones of one frequency add as phasors, the peaks of others as magnitudes (paper eq. (8)).
    The level is that of the summed powers over the threshold at each tone. SIMULATED.
    """
    from precompute.model.response import by_tone, solve_response  # compiled kernels, which only a simulation needs

    tones_hz, weight = by_tone(np.array(asked.frequencies_hz), asked.phasors)
    unit = solve_response(assemble(device), tones_hz).acceleration(position_m)
    size = abs(np.einsum("fa,fap->fp", weight, unit))
    power = ((size / device.threshold.peak_m_per_s2(tones_hz)[:, None]) ** 2).sum(axis=0)
    return size.sum(axis=0), 10 * np.log10(np.maximum(power, 1e-30))


class DrivenDevice:
    """Greets and arms the board of `device` for amplitudes of at most `most` (fractions of full scale), by actuator.

    With `accelerometer` the board streams the samples of its own to it, for as long as `wait` is called. Raises
    LinkError where no fitting board answers and where it stops itself, RendererError for a board that cannot play the
    device's displacements.
    """

    def __init__(
        self,
        device: Device,
        port: Port,
        clock: Clock,
        most: Sequence[float],
        bit_rate_hz: int = BIT_RATE_HZ,
        clicks: Basis | None = None,
        accelerometer: Listener | None = None,
    ) -> None:
        self.clock, self._device, self._accelerometer = clock, device, accelerometer
        self.session = Session(Link(_limited(device, bit_rate_hz, None, most)), port, clock.now_ns)
        self.applied_device_us: int | None = None  # when the board applied the last drive; None until STATUS says so
        self.capabilities = connect(self.session, clock)
        self.fit = fit_board(device, self.capabilities)
        configuration = _limited(device, bit_rate_hz, self.fit.scales, most)
        basis = choose_basis(clicks, self.capabilities, bit_rate_hz, configuration.lease_ms)
        self.basis = scaled(basis, self.fit.scales)  # the functions of `clicks` that the board plays
        if set(self.fit.scales) != {1.0} or self.basis.basis is not None:
            self.session.link.reconfigure(replace(configuration, basis=self.basis.basis))
            connect(self.session, clock)
        self._sense()

    @property
    def is_simulated(self) -> bool:
        """Whether an emulated firmware answers."""
        return self.capabilities.board == BOARD_EMULATED

    def play(self, drive: Drive) -> None:
        """Hold this drive from the next `wait` on. Raises RendererError for a frequency that the board lacks."""
        self.applied_device_us = None
        self.session.link.set_drive(self._encoded(drive))

    def glide(self, drive: Drive) -> None:
        """As `play`, but tones that sound run on at the new frequencies: a sweep is a dense row of these."""
        self.session.link.set_drive(self._encoded(drive), writes_phase=False)

    def _encoded(self, drive: Drive) -> bytes:
        for channel in drive.channels:
            if channel.amplitude > 0:
                check_frequencies(self._device, self.capabilities, (channel.frequency_hz, channel.frequency_hz))
        return encode_scaled(drive, self.fit.scales, self.capabilities.frequency_resolution_hz)

    def silence(self) -> None:
        """Ramp to zero with the next `wait` and stay armed."""
        self.session.link.set_silent()

    def wait(self, until_ns: int, watched: Sequence[int] = ()) -> bool:
        """Keep the drive alive until this time, or until a watched descriptor can be read; whether one can.

        Raises LinkError when the port is lost or the board has stopped itself.
        """
        while self.clock.now_ns() < until_ns:
            readable = self._exchange(until_ns, watched)
            if readable is not None and any(descriptor in readable for descriptor in watched):
                return True
        return False

    @property
    def lapses(self) -> int:
        """Leases that ended before their renewal came, since boot, as far as the board has told."""
        status = self.session.link.status
        return 0 if status is None else status.trips

    def confirm_lapses(self) -> int:
        """Wait until the board has told its lapses up to now; how many. Raises as `wait`."""
        link, now_ns = self.session.link, self.clock.now_ns()
        since_us = (now_ns + link.clock.offset_bounds(now_ns).upper_ns) / _NS_PER_US
        while link.status is None or link.status.device_time_us < since_us:
            self._exchange(None, ())
        return self.lapses

    def arm_again(self) -> None:
        """Greet and arm a board that has stopped itself; it is silent then. Raises LinkError."""
        connect(self.session, self.clock)
        self._sense()

    def _sense(self) -> None:
        if self._accelerometer is not None:
            self._accelerometer.begin_stream()
            self.session.link.start_sensing(self.clock.now_ns())

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *unused: object) -> None:
        # An error of the block says more than that the port was lost on the way out.
        with contextlib.suppress(LinkError) if kind is not None else contextlib.nullcontext():
            self._stop()

    def _stop(self) -> None:
        session = self.session
        session.link.stop(self.clock.now_ns())
        while session.link.state is LinkState.STOPPING:
            session.send()
            self._wait_for_port(None, ())
            session.receive()

    def _exchange(self, until_ns: int | None, watched: Sequence[int]) -> Container[int] | None:
        """One pass: write what is due, wait, take in what came."""
        self.session.send()
        readable = self._wait_for_port(until_ns, watched)
        events = self.session.receive()
        for event in events:
            if self._accelerometer is not None:
                self._accelerometer.take_event(event)
            # The STATUS of a change; later ones name the renewals of the drive.
            if isinstance(event, Status) and event.applied_sequence == self.session.link.drive_sequence:
                self.applied_device_us = event.applied_time_us
        self.session.send()
        if self.session.link.state is not LinkState.READY:
            faults = "".join(f" ({event.fault.name})" for event in events if isinstance(event, Fault))
            raise LinkError(f"the board stopped itself{faults}: see to the cause, then start again")
        return readable

    def _wait_for_port(self, until_ns: int | None, watched: Sequence[int]) -> Container[int] | None:
        session, now_ns = self.session, self.clock.now_ns()
        due_ns = now_ns + _BLOCKED_LINE_NS if session.wants_to_write() else session.link.next_deadline_ns()
        ends_ns = [time_ns for time_ns in (due_ns, until_ns) if time_ns is not None]
        port = session.port.fileno()
        writable = (port,) if session.wants_to_write() else ()
        return self.clock.wait(min(ends_ns, default=None), (port, *watched), writable)


def _limited(
    device: Device, bit_rate_hz: int, scales: Sequence[float] | None, most: Sequence[float]
) -> LinkConfiguration:
    """The device's limits, with amplitudes of at most `most`."""
    configuration = link_configuration(device, bit_rate_hz, scales)
    factors = scales or (1.0,) * len(most)
    limits = tuple(min(1.0, least * factor) for least, factor in zip(most, factors, strict=True))
    return replace(configuration, amplitude_limits=limits)


PATIENCE_NS = 3_000_000_000  # a converter that says nothing for longer has stopped
_NS_PER_S = 1_000_000_000


class LostWindowError(SensorError):
    """A channel lost all samples of a window, as after a stall of the host; the next window may be whole."""


class Recorder:
    """Takes windows of samples while a device is driven. Raises SensorError without any, LinkError as its `wait`."""

    def __init__(self, driven: DrivenDevice, sensor: Sensor) -> None:
        self._driven, self._sensor = driven, sensor
        self._values = [np.empty((0, len(sensor.form.channels)))]
        self._size = 0
        self._arrived_ns = 0

    def drop(self) -> None:
        """Forget the samples that have come so far."""
        while self._sensor.read() is not None:
            pass
        self._values, self._size = [self._values[0][:0]], 0

    def follow(self, until_ns: int) -> None:
        """Take in what comes until this time, while the drive changes."""
        while self._driven.clock.now_ns() < until_ns:
            if self._driven.wait(until_ns, (self._sensor.fileno(),)):
                self._take_block()

    def take_window(self, seconds: float) -> Array:
        """The next window (sample, channel), without a gap. Raises LostWindowError where a channel lost all of it."""
        count = round(seconds * self._sensor.form.sample_rate_hz)
        clock = self._driven.clock
        while self._size < count:
            is_there = self._driven.wait(clock.now_ns() + PATIENCE_NS, (self._sensor.fileno(),))
            if not self._take_block() and not is_there:
                raise SensorError(f"no samples for {PATIENCE_NS / _NS_PER_S:g} s: start the converter and its program")
        joined = np.concatenate(self._values)
        self._values, self._size = [joined[count:]], len(joined) - count
        if np.isnan(joined[:count]).all(axis=0).any():
            raise LostWindowError("a channel has lost all its samples: check its connection")
        return joined[:count]

    def _take_block(self) -> bool:
        block = self._sensor.read()
        if block is None:
            return False
        # Of a converter that delivers them, infinities are lost samples.
        self._values.append(np.where(np.isfinite(block.values), block.values, np.nan))
        self._size += len(block.values)
        self._arrived_ns = block.arrived_ns
        return True

    def arrival_ns(self, samples_before_end: int) -> int:
        """Host time by which the sample this far before the end of the last window had come, at an even pace."""
        behind = samples_before_end + self._size
        return self._arrived_ns - int(behind * _NS_PER_S / self._sensor.form.sample_rate_hz)


def known_samples(values: Array) -> Array:
    """Samples with lost ones replaced by the mean of their channel; the loss is a fault of its own."""
    if not np.isnan(values).any():
        return values
    return np.where(np.isnan(values), np.nanmean(values, axis=0), values)
