"""Stepped sine: one actuator, one frequency after the other, to the complex response of the bar at the sensor.

Theory of operation. A reading holds a tone until the bar is steady, fits it, and looks for what spoils it.

- *Steady* means that what is left of the transient is small: windows are taken one after the other. Where the last and
  the one k before it differ by d, a transient of the slowest mode, which falls by the factor q from window to window,
  is at most d q^(k-1) / (1 - q^k) in the two windows that are read. The model says q; no fixed waiting time fits both
  ends of a band. Noise is added to d, since two windows may also agree by chance.
- *A drive that lapsed* was renewed too late and stopped for a moment, after which the bar rings again. The board counts
  its lapses; where it counted one, the bar is waited for again, and what was read meanwhile is forgotten. A drive that
  goes on lapsing spoils its reading.
- *The drive is the reference.* With a loopback channel the response is the ratio of two channels of one converter, so
  that neither its clock nor its latency matters. Without one only magnitudes are known, and the result says so.
- *Levels begin low and rise.* The first drive at a place is the least; only a reading that noise or hum spoils is
  repeated at up to three times its level, and one that clips at a third. Nothing is driven above `most`. At `most`, a
  reading that is still noisy is taken over twice as many windows.
- *A sensor that stalls* repeats its last value, for longer than a period of the tone. No repetition helps.
- A reading that stays spoiled is kept with the names of its faults, so that whoever fits it can leave it out.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from base.arrays import Array
from engine.device import Device
from firmware_link.protocol.basis import EncodedClick
from firmware_link.protocol.link_errors import LinkError
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis, compute_modal_model
from tactable.measure.driven_device import (
    AskedDrive,
    DrivenDevice,
    LostWindowError,
    Recorder,
    check_drive,
    known_samples,
)
from tactable.measure.faults import MOST_DRIFT, MOST_PHASE_STEP_RAD, SPOILING, Fault, find_click_faults, find_faults
from tactable.measure.sensor import Sensor
from tactable.measure.tone_fit import ToneFit, fit_tone

T = TypeVar("T")

STEP_OF_LEVEL = 3.0  # 9.5 dB: from 5 % to full scale in three steps of the five attempts
WINDOW_S = 0.2  # 12 periods of 60 Hz; lines 6 Hz apart are told from the tone (_RESOLVED of tone_fit.py)
_SETTLED = 0.003  # of the tone: 0.026 dB, a seventh of what a reading may err (MOST_ERROR)
_REST_HZ = 37.0  # beside every line of the mains
LATE_S = 0.1  # what a command and its samples take at the most: 20 ms of a sound card, a block, the line
_ONSET = 0.05  # of the amplitude: a sine passes it within 1 % of a period; a loopback has less noise
LEAST_LOOPBACK = 1e-4  # of full scale
_REARMED = 5  # more often, and the board has a fault that arming does not mend
_LOST = 5  # windows of one reading; more, and a channel has come off
_LAPSING_NS = 20_000_000_000  # for so long the bar is waited for again in a drive that lapses
_SCATTER = 3.0  # standard deviations of a window by which noise may hide a change
_NS_PER_S = 1_000_000_000


@dataclass(frozen=True)
class SteppedSineOptions:
    """Amplitudes are fractions of full scale; window_s: length of a window; attempts: of one reading at most."""

    least: float = 0.05
    most: float = 1.0
    window_s: float = WINDOW_S
    longest_settling_s: float = 6.0
    attempts: int = 5


@dataclass(frozen=True)
class AtRest:
    """The sensor with the bar at rest, m/s^2: root mean square of its noise, hum of the mains, mean."""

    noise: float
    hum: float
    mean: float


@dataclass(frozen=True)
class Reading:
    """The response at one frequency of one actuator.

    acceleration: phasor in m/s^2 relative to the drive exp(j omega t) of this amplitude; real and positive where
    no phase is known. error: relative standard error. coherence: with the loopback, 1 without. drift: of the clock.
    """

    actuator: int
    frequency_hz: float
    amplitude: float
    acceleration: complex
    error: float
    coherence: float
    drift: float
    seconds: float
    attempts: int
    faults: tuple[Fault, ...]
    earlier: tuple[Fault, ...] = ()  # for which it was repeated; losses and lapses before the bar was steady

    @property
    def is_spoiled(self) -> bool:
        """Whether one of its faults makes it wrong."""
        return any(fault in SPOILING for fault in self.faults)


class SteppedSine:
    """Takes readings of the sensor at one place.

    decay_per_s: `slowest_decay_per_s` of the device; to compute it takes as long as an armed board waits for its host.
    """

    def __init__(
        self,
        device: Device,
        driven: DrivenDevice,
        sensor: Sensor,
        options: SteppedSineOptions,
        decay_per_s: float | None = None,
    ) -> None:
        self.device, self.driven, self.form, self.options = device, driven, sensor.form, options
        self._sensor = sensor
        self.recorder = Recorder(driven, sensor)  # takes the samples
        self.decay_per_s = slowest_decay_per_s(device) if decay_per_s is None else decay_per_s
        self._left = math.exp(-self.decay_per_s * options.window_s)
        self._amplitude = options.least
        self.rest = AtRest(0.0, 0.0, 0.0)  # the sensor with the bar at rest, as `listen` found it
        self.drift = 0.0  # the pace of the converter's clock over the board's, less 1, as found so far
        self.channel = self.form.acceleration  # index of the channel of the acceleration
        self.lossy_windows = 0  # windows in which samples were missing, beside those that a reading was made of
        self.lapsed = 0  # how often the drive lapsed while the bar became steady or was read
        self.rearmed = 0  # how often the board had stopped itself and was armed again

    def listen(self) -> AtRest:
        """Record the bar at rest; a sensor that knows the pace of its clock says it by then. Raises as `read`."""
        return self.while_armed(self._listen_once)

    def _listen_once(self) -> AtRest:
        self.driven.silence()
        self.driven.wait(self.driven.clock.now_ns() + int(LATE_S * _NS_PER_S))
        self.recorder.drop()
        values = self.recorder.take_window(2 * self.options.window_s)
        fit, channel = fit_tone(known_samples(values), self.form.sample_rate_hz, _REST_HZ), self.form.acceleration
        self.drift = self._sensor.pace()
        self.rest = AtRest(float(fit.rest[channel]), float(fit.hum[channel]), float(fit.mean[channel]))
        return self.rest

    def measure_latency(self) -> float | None:
        """Seconds from a drive to the arrival of its loopback, a block of samples included; None without loopback."""
        return self.while_armed(self._measure_latency_once)

    def _measure_latency_once(self) -> float | None:
        driven, actuators = self.driven, self.device.actuators
        which = next((i for i, actuator in enumerate(actuators) if self.form.loopback(actuator.name) is not None), None)
        if which is None:
            return None
        reference, least = self.form.loopback(actuators[which].name), self.options.least
        asked = AskedDrive.of_one(self.device, which, sum(actuators[which].band_hz) / 2, least)
        self.recorder.drop()
        driven.play(check_drive(asked, self.device))
        values = self.recorder.take_window(LATE_S + self.options.window_s)
        sounding = np.flatnonzero(abs(values[:, reference]) > _ONSET * least)
        applied_us = driven.applied_device_us
        driven.silence()
        if not len(sounding) or applied_us is None:
            return None
        clock, arrived_ns = driven.session.link.clock, self.recorder.arrival_ns(len(values) - int(sounding[0]))
        offset_ns = clock.offset_bounds(driven.clock.now_ns()).middle_ns
        return (arrived_ns - (1000 * applied_us - offset_ns)) / _NS_PER_S

    def read(self, actuator: int, frequency_hz: float) -> tuple[Reading, Array]:
        """Read the response to one actuator alone, and the last samples (sample, channel) that it is made of.

        Raises SensorError where no samples come, LinkError where the board cannot be armed again.
        """
        options, start_ns, attempts, is_done, windows = self.options, self.driven.clock.now_ns(), 0, False, 2
        earlier, lossy, lapsed = dict[Fault, None](), self.lossy_windows, self.lapsed
        while not is_done:
            attempts, amplitude = attempts + 1, self._amplitude
            asked = AskedDrive.of_one(self.device, actuator, frequency_hz, amplitude)
            fit, values, faults = self.hold(asked, windows)
            self._amplitude = self._next_amplitude(amplitude, faults)
            if Fault.NOISE in faults and self._amplitude == amplitude:
                windows *= 2
            spoiled = {fault for fault in faults if fault in SPOILING}
            # No repetition takes a line of the mains off a reading at full level; a lapsing drive had its repetitions.
            hopeless = {Fault.LAPSED, Fault.STALLED} | ({Fault.HUM} if amplitude == options.most else set())
            is_done = attempts == options.attempts or not spoiled - hopeless
            if not is_done:
                earlier |= dict.fromkeys(fault for fault in faults if fault in SPOILING)
        if self.lossy_windows > lossy:
            earlier[Fault.LOST_SAMPLES] = None
        if self.lapsed > lapsed:
            earlier[Fault.LAPSED] = None
        channel, reference = self.form.acceleration, self.reference(actuator)
        if reference is None:
            acceleration, coherence = complex(abs(fit.phasor[channel])), 1.0
        else:
            acceleration, coherence = amplitude * fit.ratio(channel, reference), fit.coherence(channel, reference)
        reading = Reading(
            actuator=actuator,
            frequency_hz=self.played_hz(frequency_hz),
            amplitude=amplitude,
            acceleration=acceleration,
            error=fit.error(channel),
            coherence=coherence,
            drift=self.drift,
            seconds=(self.driven.clock.now_ns() - start_ns) / _NS_PER_S,
            attempts=attempts,
            faults=faults,
            earlier=tuple(earlier),
        )
        return reading, values

    def _next_amplitude(self, amplitude: float, faults: tuple[Fault, ...]) -> float:
        """The level of the next drive after one with these faults."""
        if Fault.CLIPPING in faults:
            return max(self.options.least, amplitude / STEP_OF_LEVEL)
        if any(fault in faults for fault in (Fault.NOISE, Fault.HUM, Fault.NO_SIGNAL)):
            return min(self.options.most, amplitude * STEP_OF_LEVEL)
        return amplitude

    def hold(self, asked: AskedDrive, windows: int = 2) -> tuple[ToneFit, Array, tuple[Fault, ...]]:
        """Hold a drive of one frequency until the bar is steady: its fit, its samples (sample, channel), its faults.

        A board that stopped itself is armed again. Raises as `read`.
        """
        return self.while_armed(lambda: self._hold_once(asked, windows))

    def while_armed(self, take: Callable[[], T]) -> T:
        """Call `take`, again after a lost window or once a board that stopped itself is armed again; its result.

        Raises the error of a board that stops itself again and again, and of a channel that stays lost.
        """
        end = self.lossy_windows + _LOST
        while True:
            try:
                return take()
            except LostWindowError:
                self.lossy_windows += 1
                if self.lossy_windows >= end:
                    raise
            except LinkError as error:
                self.rearmed += 1
                if self.rearmed > _REARMED:
                    raise error
                self.driven.arm_again()

    def _hold_once(self, asked: AskedDrive, windows: int) -> tuple[ToneFit, Array, tuple[Fault, ...]]:
        actuator = int(np.argmax(asked.amplitudes))
        hz = self.played_hz(asked.frequencies_hz[actuator])
        self.driven.play(check_drive(asked, self.device))
        end_ns = self.driven.clock.now_ns() + _LAPSING_NS
        while self.driven.clock.now_ns() < end_ns:
            # From here on the samples are those of the drive.
            self.driven.wait(self.driven.clock.now_ns() + int(LATE_S * _NS_PER_S))
            lapses = self.driven.confirm_lapses()
            self.recorder.drop()
            values, is_steady = self._settle(hz, actuator, lapses, windows)
            if self.driven.confirm_lapses() == lapses:
                return self._judge(values, hz, actuator, is_steady)
            self.lapsed += 1
        return self._fit(values, hz), values, (Fault.LAPSED,)

    def _settle(self, hz: float, actuator: int, lapses: int, windows: int) -> tuple[Array, bool]:
        """Samples (sample, channel) of this many windows of a steady bar, and whether it is; fewer after a lapse."""
        options, taken, levels = self.options, list[Array](), list[complex]()
        while len(levels) < 2 or (
            not (is_steady := self._is_steady(levels, len(taken[-1])))
            and len(levels) * options.window_s < options.longest_settling_s
            and self.driven.lapses == lapses
        ):
            if len(levels) > 1:
                self._look_for_losses(taken[-1], hz, actuator)
            taken = [*taken[-1:], self.recorder.take_window(options.window_s)]
            levels.append(self._level(self._fit(taken[-1], hz), actuator))
        more = [self.recorder.take_window(options.window_s) for _ in range(windows - 2)] if is_steady else []
        return np.concatenate([*taken, *more]), is_steady

    def hit(self, click: EncodedClick, length_s: float) -> tuple[Array, tuple[Fault, ...]]:
        """Play a click from rest: acceleration (sample,) from before its beginning to `length_s` after, less its mean.

        The second: the faults of these samples. Raises as `read`.
        """
        return self.while_armed(lambda: self._hit_once(click, length_s))

    def _hit_once(self, click: EncodedClick, length_s: float) -> tuple[Array, tuple[Fault, ...]]:
        self.driven.silence()
        self.driven.wait(self.driven.clock.now_ns() + int(self.options.longest_settling_s / 3 * _NS_PER_S))
        self.recorder.drop()
        self.driven.session.link.set_play(click)
        values = self.recorder.take_window(length_s + 2 * LATE_S)
        acceleration = known_samples(values)[:, self.form.acceleration]
        return acceleration - np.median(acceleration), find_click_faults(values, self.form)

    def _look_for_losses(self, window: Array, hz: float, actuator: int) -> None:
        """Count a window in which the phase of the loopback steps; the wait for a steady bar passes over it."""
        reference = self.reference(actuator)
        if reference is not None and self._fit(window, hz).phase_step_rad(reference) > MOST_PHASE_STEP_RAD:
            self.lossy_windows += 1

    def _is_steady(self, levels: Sequence[complex], samples: int) -> bool:
        """Whether little of the transient is in the last two of these windows, beside the tone or beside the noise."""
        *earlier, last = levels
        noise = self.rest.noise * math.sqrt(2 / samples)
        lag, change = np.arange(len(earlier), 0, -1), abs(last - np.array(earlier))
        transient = (change + _SCATTER * noise) * self._left ** (lag - 1) / (1 - self._left**lag)
        return bool(transient.min() <= max(_SETTLED * abs(last), noise / 2))

    def _level(self, fit: ToneFit, actuator: int) -> complex:
        """The tone with its phase to the loopback, in the units of the sensor; without loopback its magnitude."""
        reference, channel = self.reference(actuator), self.form.acceleration
        if reference is None or not abs(fit.phasor[reference]) > 0:
            return complex(abs(fit.phasor[channel]))
        return fit.ratio(channel, reference) * float(abs(fit.phasor[reference]))

    def _judge(
        self, values: Array, hz: float, actuator: int, is_steady: bool
    ) -> tuple[ToneFit, Array, tuple[Fault, ...]]:
        """Fit and faults of the windows that were steady; the clock's drift is followed from reading to reading."""
        fit, reference = self._fit(values, hz), self.reference(actuator)
        faults = list(find_faults(fit, values, self.form, reference, self.rest.hum))
        if not is_steady and Fault.LOST_SAMPLES not in faults:
            faults.append(Fault.NOT_STEADY)
        if reference is not None and abs(fit.phasor[reference]) < LEAST_LOOPBACK:
            faults.append(Fault.NO_SIGNAL)
        elif reference is not None and Fault.LOST_SAMPLES not in faults:
            self.drift += fit.drift(reference)
        if abs(self.drift) > MOST_DRIFT:
            faults.append(Fault.CLOCK_DRIFT)
        return fit, values, tuple(faults)

    def _fit(self, values: Array, hz: float) -> ToneFit:
        """The fit of a tone of the board's, whose frequency a converter that runs fast sees lower."""
        return fit_tone(known_samples(values), self.form.sample_rate_hz, hz / (1 + self.drift))

    def played_hz(self, frequency_hz: float) -> float:
        """The frequency that the wire carries, which counts in steps."""
        resolution_hz = self.driven.capabilities.frequency_resolution_hz
        return round(frequency_hz / resolution_hz) * resolution_hz

    def reference(self, actuator: int) -> int | None:
        """Index of the channel that records the drive of an actuator; None without one."""
        return self.form.loopback(self.device.actuators[actuator].name)


def slowest_decay_per_s(device: Device) -> float:
    """Decay rate of the slowest mode within the sweep, by the model."""
    pole = compute_modal_model(compute_basis(assemble(device))).pole
    hz = abs(pole.imag) / (2 * np.pi)
    within = (hz > 0.5 * device.sweep.start_hz) & (hz < 1.2 * device.sweep.stop_hz)
    return float(-pole.real[within].max()) if within.any() else math.inf
