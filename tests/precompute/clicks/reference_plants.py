"""State-space plants of clicks: the closed-form response of every sampled bar with its fingers to one sample.

The plants that clicks were made with before precompute.clicks.plants, kept as they were where that decides speed and
result: 16 modes of each bar, and an eigenproblem of the damped modes for each set of fingers.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from engine.device import Finger, Threshold
from precompute.clicks.basis import EVALUATION_RATE_HZ, RINGDOWN_S, Tones, interpolated
from precompute.model.modal import Basis, compute_modal_model
from precompute.model.threshold_filter import LENGTH_S as FILTER_S
from precompute.model.threshold_filter import threshold_filter
from precompute.model.transfers import TransferFilter, step_integrals

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

MODES = 16
_AT_ONCE = 16


@dataclass(frozen=True)
class TimeDomainResponses:
    """Spectra (scenario, finger, actuator, frequency) of the weighted acceleration after one sample at full scale."""

    spectrum: Complex
    steps: int

    @property
    def _size(self) -> int:
        """Length of a transform around which nothing comes: a click, what its last sample does, and the filter."""
        click, taps = self.steps - round(RINGDOWN_S * EVALUATION_RATE_HZ), round(FILTER_S * EVALUATION_RATE_HZ)
        return int(scipy.fft.next_fast_len(click + self.steps + taps, real=True))

    @classmethod
    def of(cls, samples: Array, longest_s: float, threshold: Threshold) -> "TimeDomainResponses":
        """The responses of courses (scenario, finger, actuator, time) before the threshold filter."""
        empty = cls(np.empty(0, np.complex128), round((longest_s + RINGDOWN_S) * EVALUATION_RATE_HZ))
        weighting = scipy.fft.rfft(threshold_filter(threshold, EVALUATION_RATE_HZ), empty._size)
        return cls(scipy.fft.rfft(samples, empty._size) * weighting, empty.steps)

    def under(self, fingers: Sequence[int]) -> "TimeDomainResponses":
        """The responses of some fingers."""
        return TimeDomainResponses(self.spectrum[:, list(fingers)], self.steps)

    def first(self, scenarios: int) -> "TimeDomainResponses":
        """The responses of the first scenarios."""
        return TimeDomainResponses(self.spectrum[:scenarios], self.steps)

    def mean(self) -> "TimeDomainResponses":
        """The mean over the scenarios, as one scenario."""
        return TimeDomainResponses(self.spectrum.mean(axis=0, keepdims=True), self.steps)

    def peaks(self, waveform: Array, fingers: Sequence[int]) -> Array:
        """Greatest magnitudes (scenario, finger) of a waveform under some fingers."""
        drive, peaks = scipy.fft.rfft(interpolated(waveform), self._size), list[Array]()
        for start in range(0, len(self.spectrum), _AT_ONCE):
            spectrum = self.spectrum[start : start + _AT_ONCE, list(fingers)]
            total = spectrum[:, :, 0] * drive[0]
            for actuator in range(1, len(drive)):
                total += spectrum[:, :, actuator] * drive[actuator]
            peaks.append(np.abs(scipy.fft.irfft(total, self._size)[..., : self.steps]).max(axis=2))
        return np.concatenate(peaks)

    def play_each(self, tones: Tones, every: int = 1) -> Array:
        """Weighted acceleration (scenario, finger, time, tone) of every tone alone, at each `every`th instant."""
        drive = scipy.fft.rfft(interpolated(tones.wave), self._size)
        out = np.empty((*self.spectrum.shape[:2], -(-self.steps // every), len(drive)))
        for scenario, spectrum in enumerate(self.spectrum):
            course = scipy.fft.irfft(spectrum[:, tones.actuator] * drive, self._size)
            out[scenario] = course[..., : self.steps : every].transpose(0, 2, 1)
        return out


def sample_response(basis: Basis, fingers: list[tuple[float, Finger]], longest_s: float) -> Array:
    """Acceleration (finger, actuator, time) after one sample at full scale, in closed form: precompute.model.transient.

    Straight lines up and down within a step; of each conjugate pair of poles one is enough, counted twice.
    """
    model, place = compute_modal_model(basis, fingers), basis.at(np.array([position_m for position_m, _ in fingers]))
    step_s, modes, steps = (
        1 / EVALUATION_RATE_HZ,
        len(basis.square_omega),
        round((longest_s + RINGDOWN_S) * EVALUATION_RATE_HZ),
    )
    kept = np.flatnonzero(model.pole.imag >= 0)
    pole, spring, damper = model.pole[kept], model.spring[kept], model.damper[kept]
    phi_1, phi_2 = (integral[:, None] for integral in step_integrals(pole, step_s))
    rising = (phi_1 * damper + phi_2 * spring) / step_s
    falling = np.exp(pole * step_s)[:, None] * rising + phi_1 * spring - rising
    seen = place @ (model.vector[modes:, kept] * pole * np.where(pole.imag > 0, 2.0, 1.0))
    out = np.empty((len(place), spring.shape[1], steps))
    decay = _powers(np.exp(pole * step_s), steps - 1)
    for actuator in range(spring.shape[1]):
        out[:, actuator, 0] = (seen @ rising[:, actuator]).real
        out[:, actuator, 1:] = ((seen * falling[:, actuator]) @ decay).real
    direct, rate = place @ model.push[:, 0], place @ model.push[:, 1] / step_s
    out[..., 0] += direct + rate
    out[..., 1] -= rate
    for index, each in enumerate(basis.plant.device.actuators):
        if each.transfer is not None:
            for course in out[:, index]:
                course[:] = TransferFilter(each.transfer, EVALUATION_RATE_HZ).run(course)
    return out


def _powers(base: Complex, count: int) -> Complex:
    """Powers (base, count) from 0 on, each of two factors, since exponentials take long."""
    block = math.isqrt(count) + 1
    small, large = base[:, None] ** np.arange(block), base[:, None] ** (block * np.arange(block))
    powers: Complex = (large[:, :, None] * small[:, None, :]).reshape(len(base), -1)[:, :count]
    return powers
