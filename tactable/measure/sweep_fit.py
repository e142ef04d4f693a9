"""A recorded swept sine to the complex response at any frequency it passed: Farina's deconvolution, gated.

Theory of operation. The drive is recorded beside the acceleration. Their spectra x and y give the impulse response h,
the inverse transform of y x* / (|x|^2 + e): e keeps what the sweep did not excite from being divided by nothing. In h
the causes lie apart (Farina, AES 108, 2000; Novak, JAES 63, 2015):

- The bar's linear response begins at time 0 and rings for as long as its slowest mode. A gate around it is kept.
- A product of distortion of order k appears L ln k earlier, because an exponential sweep that stretches by e in the
  time L passed f / k that much before f. So it leaves the response alone, and is seen by itself.
- Noise lies everywhere alike. Gates of the same length, laid where neither is, say what noise is within the response.

The gate smooths the spectrum over 1 / its length. The inverse transform of |x|^2 / (|x|^2 + e), which would be a spike
if all frequencies had been driven, is gated alike and divides the result, so that e and the ends of the band cancel.
"""

import math
from dataclasses import dataclass

import numpy as np

from base.arrays import Array, Complex

_FLOOR = 0.05  # a frequency counts as not driven where the magnitude of x is below this fraction of the greatest
BEFORE_S = 0.25  # the gate opens this long before time 0, since a band of frequencies is no spike
_TAPER = 0.2  # of the gate, whose end must be soft; 0.05 passes the tests too
_NEIGHBOURS = (-2, -1, 0, 1, 2)  # widths of the gate's spectrum beside a frequency, over which noise is taken for even
_JUMP_RAD, _JUMP_SAMPLES = 0.3, 32  # a lost sample turns 60 Hz by 0.05 rad, 300 Hz by 0.24 at 8 kHz; blocks are lost


@dataclass(frozen=True)
class SweepFit:
    """Response (frequency,) and its relative standard error; drive (frequency,): magnitude of x, of a transform.

    distortion: of the second and third order, as a fraction of the linear response, root of the energies.
    """

    response: Complex
    error: Array
    drive: Array
    distortion: float


def fit_sweep(
    acceleration: Array, drive: Array, sample_rate_hz: float, frequency_hz: Array, stretch_s: float, gate_s: float
) -> SweepFit:
    """Responses at `frequency_hz` of records (sample,) that begin and end at rest.

    stretch_s: the time L in which the frequency of the sweep grows by e. gate_s: for how long the bar rings. The record
    is at least twice as long as the gate.
    """
    count = len(drive)
    # Tapered while the bar is at rest, so that hum and offset do not leak into all frequencies.
    calm = np.minimum(1.0, np.minimum(np.arange(count), np.arange(count)[::-1]) / (BEFORE_S * sample_rate_hz))
    rest = (acceleration - acceleration.mean()) * (0.5 - 0.5 * np.cos(np.pi * calm))
    x, y = np.fft.rfft(drive), np.fft.rfft(rest)
    power = abs(x) ** 2
    floor = _FLOOR**2 * power[1:].max()
    h = np.fft.irfft(y * x.conj() / (power + floor), count)
    spike = np.fft.irfft(power / (power + floor), count)
    before, length = round(BEFORE_S * sample_rate_hz), round((BEFORE_S + gate_s) * sample_rate_hz)
    window = _gate(before, length)

    def gated(signal: Array, start: int, hz: Array) -> Complex:
        """Spectrum (frequency,) of the gate that begins at a sample of the circular signal; time 0 is its `before`."""
        part = window * np.take(signal, np.arange(start, start + length), mode="wrap")
        return transform_at(part, hz / sample_rate_hz) * np.exp(2j * np.pi * hz / sample_rate_hz * before)

    beside_hz = frequency_hz[:, None] + np.array(_NEIGHBOURS) * sample_rate_hz / length
    own, driven = gated(h, -before, frequency_hz), gated(spike, -before, frequency_hz)
    free = range(length, count - length + 1, length)
    noise = np.array([abs(gated(h, start - before, beside_hz.ravel())) ** 2 for start in free])
    scatter = np.sqrt(noise.reshape(len(free), *beside_hz.shape).mean(axis=(0, 2)))
    return SweepFit(
        response=own / driven,
        error=scatter / np.maximum(abs(own), 1e-300),
        drive=np.interp(frequency_hz, np.fft.rfftfreq(count, 1 / sample_rate_hz), abs(x)),
        distortion=_distortion(h, sample_rate_hz, stretch_s),
    )


def transform_at(signal: Array, turns: Array) -> Complex:
    """Fourier transform (frequency,) of samples at frequencies in turns a sample, by blocks of samples.

    exp(-j w (a B + b)) is a product, so that a table of the blocks and one within them are enough.
    """
    block = math.isqrt(len(signal)) + 1
    padded = np.zeros(block * block)
    padded[: len(signal)] = signal
    within: Complex = np.exp(-2j * np.pi * np.outer(turns, np.arange(block)))
    blocks: Complex = np.exp(-2j * np.pi * block * np.outer(turns, np.arange(block)))
    return (blocks * (within @ padded.reshape(block, block).T)).sum(axis=1)


def _gate(before: int, length: int) -> Array:
    """Weights (sample,): raised cosines at both ends, 1 from just before time 0 until the last fifth."""
    rise, fall = round(0.8 * before), round(_TAPER * length)
    window = np.ones(length)
    window[:rise] = 0.5 - 0.5 * np.cos(np.pi * np.arange(rise) / rise)
    window[length - fall :] = 0.5 + 0.5 * np.cos(np.pi * np.arange(1, fall + 1) / fall)
    return window


def _distortion(h: Array, sample_rate_hz: float, stretch_s: float) -> float:
    """Products of the second and third order over the linear response, each within a quarter of a second."""
    half = round(BEFORE_S / 2 * sample_rate_hz)

    def energy(time_s: float) -> float:
        middle = round(time_s * sample_rate_hz)
        return float((np.take(h, np.arange(middle - half, middle + half), mode="wrap") ** 2).sum())

    noise = energy(-stretch_s * math.log(2.5))
    products = [max(0.0, energy(-stretch_s * math.log(order)) - noise) for order in (2, 3)]
    return math.sqrt(sum(products) / max(energy(0.0), 1e-300))


def has_jumps(drive: Array) -> bool:
    """Whether the phase of a recorded sweep (sample,) jumps, as it does where samples are missing."""
    spectrum, far = np.fft.fft(drive), _JUMP_SAMPLES
    spectrum[len(drive) // 2 :] = 0
    analytic = np.fft.ifft(spectrum)
    is_faint = abs(analytic) < 0.5 * np.percentile(abs(analytic), 90)
    # The ends of a sweep turn unevenly: only what is loud for a while before and after counts.
    is_loud = np.convolve(is_faint, np.ones(8 * far + 1), "same") < 0.5
    turned = analytic[far:] * analytic[:-far].conj()
    # An even sweep turns as far in one stretch as in the one before, but for some hundredths.
    change = np.angle(turned[far:] * turned[:-far].conj())
    sounding = is_loud[: -2 * far] & is_loud[far:-far] & is_loud[2 * far :]
    return bool((sounding & (abs(change) > _JUMP_RAD)).any())
