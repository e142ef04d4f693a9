"""Time courses that a click must keep within a limit: their values for any weights, and their rows of the program."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from base.arrays import Array, Integers, Single
from base.compiled import njit
from precompute.clicks.click_basis import Tones
from precompute.clicks.click_responses import Responses
from precompute.model.damped_lines import SIGMA_PER_S


@dataclass(frozen=True)
class WatchedCourses:
    """Time courses under fingers (course = scenario * fingers + finger) at every sample of the waveform."""

    responses: Responses
    tones: Tones

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of courses and of samples of each."""
        scenarios, fingers = self.responses.transfer.shape[:2]
        return scenarios * fingers, self.responses.lines.steps

    def play(self, weight: Array) -> Single:
        """Magnitudes (course, sample) for weights (tone,)."""
        course = self.responses.lines.course(self.responses.spectrum(self.tones.waveform(weight)))
        return np.abs(course).reshape(self.shape)

    def rows(self, numbers: Integers) -> Array:
        """Rows (row, tone) at instants given as course * samples + sample."""
        course, sample = np.divmod(numbers, self.shape[1])
        reversed_past = np.empty((len(numbers), self._impulse.shape[1], self._taps), np.float32)
        _gather(self._impulse, course, sample, reversed_past)
        actuators = [self.tones.actuator == actuator for actuator in range(reversed_past.shape[1])]
        out = np.empty((len(numbers), len(self.tones.actuator)))
        for actuator, own in enumerate(actuators):
            out[:, own] = reversed_past[:, actuator] @ self._wave[own].T
        return out

    @property
    def _taps(self) -> int:
        """Samples of a click without the first and the last, which are 0."""
        return int(self.tones.wave.shape[1]) - 2

    @cached_property
    def _wave(self) -> Single:
        """The tones (tone, tap) in single precision, as the responses are."""
        return self.tones.wave[:, 1:-1].astype(np.float32)

    @cached_property
    def _impulse(self) -> Single:
        """Response (course, actuator, time) to one sample of each actuator, from `_taps` samples before it."""
        lines, before = self.responses.lines, self._taps
        period = lines.period(self.responses.transfer)
        # Before the sample there is only the ringing of the band limit.
        ahead = np.exp(-SIGMA_PER_S * np.arange(before, 0, -1) / lines.rate_hz).astype(np.float32)
        impulse = np.concatenate(
            [period[..., -before:] * ahead, period[..., : lines.steps] * lines.growth[: lines.steps]], axis=-1
        )
        return impulse.reshape(-1, *impulse.shape[2:])


@njit(nogil=True, cache=True)
def _gather(impulse: Single, course: Integers, sample: Integers, out: Single) -> None:
    """Fill out (row, actuator, tap): responses at instant `sample` of `course` to samples 1, 2, ... of a waveform."""
    taps = out.shape[2]
    for i in range(len(course)):
        for a in range(out.shape[1]):
            for k in range(taps):
                # Time since sample k + 1; the impulse begins `taps` samples ahead of its own.
                out[i, a, k] = impulse[course[i], a, sample[i] - (k + 1) + taps]
