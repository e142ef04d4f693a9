"""Swept sine: one actuator glides through its band, to the complex responses of the bar at the sensor at once.

Theory of operation. The board plays one frequency at a time. A SET that leaves the phase alone lets the oscillator run
on at another frequency, so a dense row of them, STEP_NS apart, is one tone that glides: the bar never settles, and no
frequency of the band is left out. Lease, slew and amplitude limits hold as in a run, and no message is added to the
wire. When each SET came does not matter, since the drive is recorded beside the acceleration by a loopback channel and
the response is the quotient of the two records (`sweep_fit`). Without that channel there is no sweep.

- *Levels begin low and rise*, as for the stepped sine: a sweep in which noise hides many wanted frequencies is
  repeated at three times its level up to `most`, one that clips at a third, one that lost samples at its own.
- *Repeats*: the sweep that was good is repeated at its level. The coherence is that of the repeats, and responses that
  differ by more than their errors allow are not steady.
- The converter's clock is compared with the board's on a held tone first, since a resonance is narrower than what a
  clock that is off moves it by.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from base.arrays import Array
from engine.render.limits import Drive
from tactable.measure.driven_device import AskedDrive, check_drive, known_samples
from tactable.measure.faults import (
    MOST_DISTORTION,
    MOST_DRIFT,
    MOST_ERROR,
    MOST_HUM_BESIDE,
    MOST_PHASE_STEP_RAD,
    Fault,
    has_offset,
    is_clipped,
    is_stalled,
)
from tactable.measure.sensor import SensorError
from tactable.measure.stepped_sine import LATE_S, LEAST_LOOPBACK, STEP_OF_LEVEL, Reading, SteppedSine
from tactable.measure.sweep_fit import BEFORE_S, SweepFit, fit_sweep, has_jumps
from tactable.measure.tone_fit import HUM_LINES, MAINS_HZ, fit_tone

STEP_NS = 10_000_000  # between two frequencies: 0.5 Hz apart at 300 Hz and a sweep of 6 s, 0.02 rad off an even glide
_MARGIN = 0.05  # a sweep goes this fraction beyond the outermost wanted frequencies, where the band allows it
_REST_S = BEFORE_S + 0.1  # the gate opens BEFORE_S ahead of the sweep, which may begin a little late
_CLOCK_S = 1.0
_LEFT_S = 6.0  # time constants of the slowest mode for which the bar rings: a thousandth is left
_SHORTEST_GATE_S, _LONGEST_GATE_S = 0.5, 4.0  # 2 Hz and 0.25 Hz apart; the rest of a longer ringing counts as noise
_BESIDE = 1.5  # widths of the gate's spectrum within which a line of the mains is beside a frequency
_PARTS = 50  # parts of a record that are looked at for clipping: it clips at a resonance only
_STEADY = 5.0  # standard errors, as _STANDS_OUT of tone_fit.py
_FEW = 0.05  # noise in fewer of the frequencies, where the bar hardly moves, is named and raises no level
_NS_PER_S = 1_000_000_000


@dataclass(frozen=True)
class SweepOptions:
    """sweep_s: from the lowest to the highest frequency; repeats: records of the level that was good, 2 or more."""

    sweep_s: float = 6.0
    repeats: int = 2


class SweptSine:
    """Takes the responses of the sensor of a `SteppedSine`, which has listened to the bar at rest."""

    def __init__(self, stepped: SteppedSine, sweep: SweepOptions) -> None:
        self._device, self._driven, self._form, self._stepped = stepped.device, stepped.driven, stepped.form, stepped
        self._options, self._sweep = stepped.options, sweep
        self._gate_s = min(max(_LEFT_S / stepped.decay_per_s, _SHORTEST_GATE_S), _LONGEST_GATE_S)
        self._amplitude = stepped.options.least
        self._is_clock_known = False

    def read(self, actuator: int, frequencies_hz: Array) -> tuple[list[Reading], list[Array]]:
        """Readings at these frequencies, and the records (sample, channel) that they are made of.

        Raises SensorError without a loopback channel and where no samples come, LinkError as `SteppedSine.read`.
        """
        reference, start_ns = self._stepped.reference(actuator), self._driven.clock.now_ns()
        if reference is None:
            name = self._device.actuators[actuator].name
            raise SensorError(
                f"a sweep needs the drive of {name} recorded beside the acceleration: add the channel 'loopback {name}'"
                " to the samples, or measure with --method stepped"
            )
        if not self._is_clock_known:
            self._stepped.while_armed(lambda: self._compare_clocks(actuator, reference))
        kept, earlier, attempts = list[_Sweep](), dict[Fault, None](), 0
        most, is_complete = self._options.most, False
        while not is_complete:
            attempts += 1
            sweep = self._take_sweep(actuator, reference, frequencies_hz)
            earlier |= dict.fromkeys(sweep.faults)
            if Fault.CLIPPING in sweep.faults:
                # What clipped once is not tried again.
                most = min(most, max(self._options.least, sweep.amplitude / STEP_OF_LEVEL))
                self._amplitude = most
            elif not sweep.faults and sweep.is_noisy and sweep.amplitude < most:
                earlier[Fault.NOISE] = None
                self._amplitude = min(most, sweep.amplitude * STEP_OF_LEVEL)
            elif not sweep.faults:
                kept.append(sweep)
            # Noise at full level is averaged out as far as the attempts go.
            wanted = self._sweep.repeats + (self._options.attempts if sweep.is_noisy else 0)
            is_complete = len(kept) >= wanted or attempts == self._options.attempts + self._sweep.repeats
        seconds = (self._driven.clock.now_ns() - start_ns) / _NS_PER_S
        if not kept:
            kept = [sweep]
        readings = self._readings(kept, actuator, frequencies_hz)
        share_s, named = seconds / len(readings), tuple(earlier)
        whole = [replace(each, seconds=share_s, attempts=attempts, earlier=named) for each in readings]
        return whole, [each.values for each in kept]

    def _take_sweep(self, actuator: int, reference: int, frequencies_hz: Array) -> "_Sweep":
        """One sweep at the present level; a board that stopped itself is armed again."""
        lowest_hz, highest_hz = self._device.actuators[actuator].band_hz
        low_hz = max(lowest_hz, float(frequencies_hz.min()) * (1 - _MARGIN))
        high_hz = min(highest_hz, float(frequencies_hz.max()) * (1 + _MARGIN))
        stretch_s = self._sweep.sweep_s / math.log(high_hz / low_hz)
        values = self._stepped.while_armed(lambda: self._record(actuator, low_hz, stretch_s))
        known, form = known_samples(values), self._form
        drive, amplitude = known[:, reference], self._amplitude
        fit = fit_sweep(
            known[:, form.acceleration],
            drive,
            form.sample_rate_hz,
            # A converter that runs fast sees a tone lower.
            frequencies_hz / (1 + self._stepped.drift),
            stretch_s,
            self._gate_s,
        )
        rate_hz = form.sample_rate_hz
        swept = values[round(_REST_S * rate_hz) : round((_REST_S + self._sweep.sweep_s) * rate_hz), form.acceleration]
        causes = {
            Fault.STALLED: is_stalled(swept, math.ceil(rate_hz / low_hz)),
            Fault.CLIPPING: any(is_clipped(part, form) for part in np.array_split(values, _PARTS)),
            Fault.LOST_SAMPLES: bool(np.isnan(values).any()) or has_jumps(drive),
            Fault.NO_SIGNAL: bool(abs(drive).max() < LEAST_LOOPBACK),
        }
        faults = tuple(fault for fault, is_there in causes.items() if is_there)
        is_noisy = float((fit.error > MOST_ERROR).mean()) > _FEW
        return _Sweep(amplitude, values, fit, faults, is_noisy)

    def _record(self, actuator: int, low_hz: float, stretch_s: float) -> Array:
        """Samples (sample, channel) of one sweep, from rest to rest."""
        driven, recorder, sweep_s = self._driven, self._stepped.recorder, self._sweep.sweep_s
        driven.silence()
        driven.wait(driven.clock.now_ns() + int(LATE_S * _NS_PER_S))
        recorder.drop()
        start_ns = driven.clock.now_ns() + int(_REST_S * _NS_PER_S)
        recorder.follow(start_ns)
        driven.play(self._drive(actuator, low_hz))
        end_ns, now_ns = start_ns + int(sweep_s * _NS_PER_S), start_ns
        while now_ns < end_ns:
            recorder.follow(now_ns + STEP_NS)
            now_ns = driven.clock.now_ns()
            gone_s = min(now_ns - start_ns, end_ns - start_ns) / _NS_PER_S
            driven.glide(self._drive(actuator, low_hz * math.exp(gone_s / stretch_s)))
        driven.silence()
        # Twice the gate, so that noise is known from where the response is not.
        return recorder.take_window(
            max(_REST_S + sweep_s + 2 * LATE_S + self._gate_s, 2.05 * (BEFORE_S + self._gate_s))
        )

    def _drive(self, actuator: int, frequency_hz: float) -> Drive:
        return check_drive(AskedDrive.of_one(self._device, actuator, frequency_hz, self._amplitude), self._device)

    def _compare_clocks(self, actuator: int, reference: int) -> None:
        """Measure the drift of the converter's clock on a tone of the board's."""
        driven, recorder = self._driven, self._stepped.recorder
        hz = self._stepped.played_hz(math.sqrt(math.prod(self._device.actuators[actuator].band_hz)))
        driven.play(self._drive(actuator, hz))
        driven.wait(driven.clock.now_ns() + int(2 * LATE_S * _NS_PER_S))
        recorder.drop()
        values = known_samples(recorder.take_window(_CLOCK_S))
        driven.silence()
        fit = fit_tone(values, self._form.sample_rate_hz, hz / (1 + self._stepped.drift))
        is_whole = fit.phase_step_rad(reference) < MOST_PHASE_STEP_RAD
        if abs(fit.phasor[reference]) >= LEAST_LOOPBACK and is_whole:
            self._stepped.drift += fit.drift(reference)
            self._is_clock_known = True

    def _readings(self, kept: "list[_Sweep]", actuator: int, frequencies_hz: Array) -> list[Reading]:
        """The mean of the repeats at each frequency, their coherence, and what spoils it."""
        responses = np.array([sweep.fit.response for sweep in kept])
        weight = np.array([sweep.amplitude for sweep in kept]) ** 2
        mean = weight @ responses / weight.sum()
        power = (abs(responses) ** 2).mean(axis=0)
        coherence = abs(responses.mean(axis=0)) ** 2 / np.maximum(power, 1e-300)
        single = np.array([sweep.fit.error for sweep in kept])
        error = 1 / np.sqrt((1 / np.maximum(single, 1e-12) ** 2).sum(axis=0))
        apart = abs(responses - mean).max(axis=0) / np.maximum(abs(mean), 1e-300)
        last = kept[-1]
        loud = self._hum_of(last, frequencies_hz) > MOST_HUM_BESIDE * abs(last.fit.response)
        marks = {
            Fault.HUM: loud,
            Fault.NOISE: (error > MOST_ERROR) & ~loud,
            Fault.NOT_STEADY: apart > np.maximum(MOST_ERROR, _STEADY * single.max(axis=0)),
            Fault.OFFSET: np.full(len(mean), has_offset(self._stepped.rest.mean)),
            Fault.DISTORTION: np.full(len(mean), last.fit.distortion > MOST_DISTORTION),
            Fault.CLOCK_DRIFT: np.full(len(mean), abs(self._stepped.drift) > MOST_DRIFT),
        }
        return [
            Reading(
                actuator=actuator,
                frequency_hz=float(hz),
                amplitude=last.amplitude,
                acceleration=complex(last.amplitude * mean[i]),
                error=float(error[i]),
                coherence=float(coherence[i]),
                drift=self._stepped.drift,
                seconds=0.0,
                attempts=len(kept),
                faults=(*last.faults, *(fault for fault, is_there in marks.items() if is_there[i])),
            )
            for i, hz in enumerate(frequencies_hz)
        ]

    def _hum_of(self, sweep: "_Sweep", frequencies_hz: Array) -> Array:
        """Part of the response (frequency,) that the hum of the bar at rest may be, near lines of the mains."""
        lines_hz = np.array([k * hz for hz in MAINS_HZ for k in range(1, HUM_LINES + 1)])
        apart_hz = abs(frequencies_hz[:, None] - lines_hz).min(axis=1)
        gate_s = self._gate_s + BEFORE_S
        line = self._stepped.rest.hum * gate_s * self._form.sample_rate_hz / 2 / np.maximum(sweep.fit.drive, 1e-300)
        return np.where(apart_hz < _BESIDE / gate_s, line, 0.0)


@dataclass(frozen=True)
class _Sweep:
    """One sweep: its samples (sample, channel), its fit, what spoils all of it, whether noise hides many of it."""

    amplitude: float
    values: Array
    fit: SweepFit
    faults: tuple[Fault, ...]
    is_noisy: bool
