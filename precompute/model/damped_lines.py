"""Frequency lines with damping, s = sigma + j omega: transforms of signals that ring on, without wrap-around.

The discrete Fourier transform of x(t) exp(-sigma t) samples the Laplace transform of x on such a line. What rings on
beyond the period wraps around attenuated by exp(-sigma period), and the inverse is multiplied by exp(sigma t) again (F.
Durbin, Comput. J. 17, 1974). Lines end where nothing more is felt: the transfer functions are band-limited.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.fft

from base.arrays import Array, Complex, Complex32, Single

SIGMA_PER_S = 25.0  # wrap-around is attenuated to 1/1000 in 0.27 s; single precision keeps 3e-5 at the end
_MARGIN_S = 0.04  # time by which the period exceeds the evaluated course


@dataclass(frozen=True)
class DampedLines:
    """Lines (line,) up to `top_hz` for courses of `steps` samples at `rate_hz`."""

    rate_hz: float
    steps: int
    top_hz: float

    @cached_property
    def size(self) -> int:
        """Samples in a period."""
        return int(scipy.fft.next_fast_len(self.steps + round(_MARGIN_S * self.rate_hz), real=True))

    @cached_property
    def s_per_s(self) -> Complex:
        """The lines (line,), 1/s."""
        period_s = self.size / self.rate_hz
        count = min(int(self.top_hz * period_s), self.size // 2) + 1
        omega = 2 * np.pi * np.arange(count) / period_s
        return (SIGMA_PER_S + 1j * omega).astype(np.complex128)

    @cached_property
    def growth(self) -> Single:
        """exp(sigma t) at every sample of a period, (time,)."""
        return np.exp(SIGMA_PER_S * np.arange(self.size) / self.rate_hz).astype(np.float32)

    @cached_property
    def decay(self) -> Array:
        """exp(-sigma t) at every sample of a period, (time,)."""
        return np.asarray(np.exp(-SIGMA_PER_S * (np.arange(self.size) / self.rate_hz)))

    def transform(self, course: Array) -> Complex32:
        """Lines (..., line) of courses (..., time) that begin at time 0 and end within the period."""
        spectrum = scipy.fft.rfft(course * self.decay[: course.shape[-1]], self.size)
        return spectrum[..., : len(self.s_per_s)].astype(np.complex64)

    def period(self, spectrum: Complex32, oversampling: int = 1) -> Single:
        """A whole period (..., time) of spectra (..., line), still attenuated by exp(-sigma t), oversampled."""
        course: Single = scipy.fft.irfft(spectrum, oversampling * self.size)
        return course * np.float32(oversampling) if oversampling > 1 else course

    def course(self, spectrum: Complex32, oversampling: int = 1) -> Single:
        """Courses (..., time) of spectra (..., line): `oversampling` samples for each of `steps`."""
        steps = oversampling * self.steps
        if oversampling == 1:
            return self.period(spectrum)[..., :steps] * self.growth[:steps]
        time_s = np.arange(steps) / (oversampling * self.rate_hz)
        return self.period(spectrum, oversampling)[..., :steps] * np.exp(SIGMA_PER_S * time_s).astype(np.float32)
