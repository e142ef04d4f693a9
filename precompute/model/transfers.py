"""Transfer functions of actuators and the detection threshold, as factors of tones and as filters in time."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import ztbsv

from base.arrays import Array, Complex
from engine.device import Actuator, Threshold, Transfer


def transfers_at(actuators: Sequence[Actuator], s_per_s: NDArray[np.complexfloating[Any, Any]]) -> Complex | None:
    """H (..., actuator) at complex frequencies (...,), 1/s; None where every base moves as commanded."""
    if not any(actuator.transfer or actuator.delay_s for actuator in actuators):
        return None
    late = [np.exp(-actuator.delay_s * s_per_s) for actuator in actuators]
    return np.stack(
        [h if a.transfer is None else h * a.transfer.series.at(s_per_s) for h, a in zip(late, actuators, strict=True)],
        axis=-1,
    )


def moved_bases(actuators: Sequence[Actuator], frequency_hz: Array, amplitude: Complex) -> Complex:
    """Displacements (actuator,) of the bases under commanded tones, frequency_hz and amplitude (actuator,).

    Both are complex fractions of full scale; the frequency of an actuator of amplitude 0 does not matter.
    """
    factors = transfers_at(actuators, 2j * np.pi * np.where(amplitude == 0, 1.0, frequency_hz))
    return amplitude if factors is None else amplitude * np.diagonal(factors)


class DelayFilter:
    """A delay in time, fed stretch after stretch: between samples the course is straight."""

    def __init__(self, delay_s: float, sample_rate_hz: float) -> None:
        self._whole, self._part = divmod(delay_s * sample_rate_hz, 1.0)
        self._past = np.zeros(int(self._whole) + 1)

    def run(self, course: Array) -> Array:
        """The next stretch (time,) of a course, late."""
        all_of_it = np.append(self._past, course)
        self._past = all_of_it[len(course) :]
        return (1 - self._part) * all_of_it[1 : len(course) + 1] + self._part * all_of_it[: len(course)]


class TransferFilter:
    """A transfer function in time, fed stretch after stretch: exact where the course is straight between samples."""

    def __init__(self, transfer: Transfer, sample_rate_hz: float) -> None:
        series, self._step_s = transfer.series, 1 / sample_rate_hz
        self._direct, self._pole = series.direct, np.array(series.pole_per_s, dtype=np.complex128)
        # A pole with an imaginary part stands for its conjugate too.
        self._residue = np.array(series.residue_per_s) * np.where(self._pole.imag > 0, 2.0, 1.0)
        self._last, self._state = 0.0, np.zeros(len(self._pole), dtype=np.complex128)

    def run(self, course: Array) -> Array:
        """Response to the next stretch (time,) of a course."""
        before = np.append(self._last, course[:-1])
        rate = (course - before) / self._step_s
        grow = np.exp(self._pole * self._step_s)
        phi_1, phi_2 = step_integrals(self._pole, self._step_s)
        out = self._direct * course
        for k, residue in enumerate(self._residue):
            state = decaying_sums(grow[k], phi_1[k] * before + phi_2[k] * rate, self._state[k])
            self._state[k] = state[-1]
            out += (residue * state).real
        self._last = float(course[-1])
        return out


def decaying_sums(grow: complex, forced: Complex, before: complex) -> Complex:
    """States z (time,) of z[n] = grow z[n - 1] + forced[n], after the state `before`.

    By substitution in a matrix of two diagonals, as `scipy.signal.lfilter` to the last bit, which takes 1 s to import.
    """
    band = np.empty((2, len(forced)), dtype=np.complex128, order="F")
    band[0], band[1] = 1.0, -grow
    start = forced.copy()
    start[0] += grow * before
    return ztbsv(1, band, start, lower=1, diag=1, overwrite_x=1)


def step_integrals(pole: Complex, step_s: float) -> tuple[Complex, Complex]:
    """Integrals over one step of exp(pole t) and of exp(pole (step - t)) t; their limits for a pole near zero."""
    slow = abs(pole) * step_s < 1e-9
    safe = np.where(slow, 1.0, pole)
    phi_1 = np.where(slow, step_s, np.expm1(safe * step_s) / safe)
    return phi_1, np.where(slow, step_s**2 / 2, (phi_1 - step_s) / safe)


LENGTH_S = 0.1
"""Length of the filter; what is cut off changes its magnitude by less than 0.03 dB from 30 Hz to 1 kHz.

For the curve `android`, which has corners close to each other, by less than 0.2 dB.
"""
_LOWEST_HZ = 10.0  # below, where nothing is known and the bar has no mode, the threshold is held
_FINE = 1 << 16


def threshold_filter(threshold: Threshold, sample_rate_hz: float) -> Array:
    """Taps (time,) whose magnitude is one over the detection threshold at every frequency, by the minimum phase.

    Causal and with the least delay: nothing is felt before the bar moves, so that times of being felt mean something;
    a zero-phase filter would ring ahead of the click. Of a steady tone it keeps the sensation level. The phase follows
    from the folded cepstrum (Oppenheim and Schafer, Discrete-Time Signal Processing, homomorphic systems).
    """
    frequency_hz = np.maximum(np.fft.rfftfreq(_FINE, 1 / sample_rate_hz), _LOWEST_HZ)
    cepstrum = np.fft.irfft(-np.log(threshold.peak_m_per_s2(frequency_hz)))
    cepstrum[1 : _FINE // 2] *= 2
    cepstrum[_FINE // 2 + 1 :] = 0
    return np.fft.irfft(np.exp(np.fft.rfft(cepstrum)))[: round(LENGTH_S * sample_rate_hz)]
