"""Weighted acceleration under every finger in sampled plants, for a waveform, and its peaks."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from base.arrays import Array, Complex32, Single
from base.compiled import njit
from precompute.clicks.click_basis import EVALUATIONS_PER_SAMPLE
from precompute.model.damped_lines import DampedLines

_AT_ONCE = 64  # time courses transformed at once, so that they stay in the processor's cache


@dataclass(frozen=True)
class Responses:
    """Transfer functions (scenario, finger, actuator, line) to weighted acceleration; 1 is the detection threshold."""

    transfer: Complex32
    lines: DampedLines

    @property
    def steps(self) -> int:
        """Number of instants that are evaluated from the start of the click, at EVALUATION_RATE_HZ."""
        return EVALUATIONS_PER_SAMPLE * self.lines.steps

    def under(self, fingers: Sequence[int]) -> "Responses":
        """The responses of some fingers."""
        return Responses(np.ascontiguousarray(self.transfer[:, list(fingers)]), self.lines)

    def first(self, scenarios: int) -> "Responses":
        """The responses of the first scenarios."""
        return Responses(self.transfer[:scenarios], self.lines)

    def play(self, waveform: Array) -> Single:
        """Weighted acceleration (scenario, finger, time) at EVALUATION_RATE_HZ under displacements (actuator, time)."""
        return self.lines.course(self.spectrum(waveform), EVALUATIONS_PER_SAMPLE)

    def peaks(self, waveform: Array, fingers: Sequence[int]) -> Array:
        """Greatest magnitudes (scenario, finger) of a waveform under some fingers, between samples too."""
        return self.under(fingers).played(waveform)[1]

    def played(self, waveform: Array) -> tuple[Single, Array]:
        """Courses (scenario, finger, time) at half the sample rate, and their greatest magnitudes (scenario, finger).

        Magnitudes are right between samples too; the courses serve to compare plants.
        """
        drive, lines = self.lines.transform(waveform), self.lines
        # One row for each finger of each scenario, some rows at a time to stay in the caches.
        transfer = self.transfer.reshape(-1, *self.transfer.shape[2:])
        peaks = np.empty(len(transfer), np.float32)
        courses = np.empty((len(transfer), (lines.steps + 1) // 2), np.float32)
        for start in range(0, len(transfer), _AT_ONCE):
            part = slice(start, start + _AT_ONCE)
            course = lines.period(combine(transfer[part], drive))
            _fill_peaks(course, lines.growth[: lines.steps], peaks[part])
            np.multiply(course[:, : lines.steps : 2], lines.growth[: lines.steps : 2], out=courses[part])
        shape = self.transfer.shape[:2]
        return courses.reshape(*shape, -1), peaks.reshape(shape).astype(np.float64)

    def spectrum(self, waveform: Array) -> Complex32:
        """Lines (scenario, finger, line) of the weighted acceleration under displacements (actuator, time)."""
        drive = self.lines.transform(waveform)
        sums = combine(self.transfer.reshape(-1, *self.transfer.shape[2:]), drive)
        return sums.reshape(*self.transfer.shape[:2], drive.shape[-1])


@njit(nogil=True, cache=True, fastmath=True, error_model="numpy")
def combine(transfer: Complex32, drive: Complex32) -> Complex32:
    """Sum over actuators of transfer (course, actuator, line) times drive (actuator, line)."""
    courses, actuators, lines = transfer.shape
    out = np.zeros((courses, lines), np.complex64)
    for i in range(courses):
        for a in range(actuators):
            for k in range(lines):
                out[i, k] += transfer[i, a, k] * drive[a, k]
    return out


@njit(nogil=True, cache=True, fastmath=True, error_model="numpy")
def _fill_peaks(course: Single, growth: Single, out: Single) -> None:
    """Greatest magnitude of each course (course, time) times growth (time,), halfway between samples too.

    There by the interpolation of six neighbours, which is right to 0.5 % up to an eighth of the sampling rate.
    """
    # Lagrange's weights of six even neighbours, halfway: 75/128, -25/256, 3/256.
    near, next_to, far = np.float32(0.5859375), np.float32(-0.09765625), np.float32(0.01171875)
    steps = len(growth)
    value = np.empty(steps, np.float32)
    for i in range(len(course)):
        highest = np.float32(0.0)
        for t in range(steps):
            value[t] = course[i, t] * growth[t]
            highest = max(highest, abs(value[t]))
        # Up to an eighth of the rate a maximum is at most 1 / cos(pi / 8) = 1.08 times its greater neighbour.
        best, worth = highest, np.float32(0.85) * highest
        for t in range(3, steps - 3):
            size = abs(value[t])
            if size > worth and size >= abs(value[t - 1]) and size >= abs(value[t + 1]):
                for left in range(t - 1, t + 1):
                    between = near * (value[left] + value[left + 1])
                    between += next_to * (value[left - 1] + value[left + 2]) + far * (value[left - 2] + value[left + 3])
                    best = max(best, abs(between))
        out[i] = best
