"""A window of samples to the complex amplitude of one driven tone, with what spoils it.

Theory of operation. The tone's frequency is known, since the board made it. A least-squares fit over the window has the
tone, its second and third harmonic, a constant and the lines of the mains that can be told from the tone in a window of
this length; so neither offset nor hum leaks into the tone, as they would into a Fourier transform of so few periods.
The rest of the window is noise, or a transient. The tone and the rest together, demodulated part by part, show how far
the response repeats within the window: its scatter gives the standard error and the coherence, and its phase the drift
of the converter's clock.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np

from base.arrays import Array, Complex

PARTS = 8  # parts of a window, whose scatter is the error of the whole
MAINS_HZ = (50.0, 60.0)  # of all grids
HUM_LINES = 5  # 250 and 300 Hz: to the end of the band
_HARMONICS = (2, 3)  # the greatest of an actuator's distortion; higher ones are in `rest`
_STANDS_OUT = 5.0  # standard errors of a line's amplitude: of ten lines one is by chance that great in 10 000 windows
_RESOLVED = 1.2  # periods of the window by which two lines must differ to be told apart


@dataclass(frozen=True)
class ToneFit:
    """The tone in a window, by channel, as phasors of exp(j 2 pi f t) from the window's first sample.

    phasor (channel,); parts (part, channel): the same within each part of the window. hum (channel,): greatest
    amplitude of a line of the mains, 0 where noise alone could be as great. distortion (channel,): amplitude of the
    second and third harmonic. rest (channel,): root mean square of what is left. mean (channel,).
    """

    frequency_hz: float
    duration_s: float
    phasor: Complex
    parts: Complex
    hum: Array
    distortion: Array
    rest: Array
    mean: Array

    def ratio(self, channel: int, reference: int) -> complex:
        """The tone in a channel over that in the reference."""
        return complex(self.phasor[channel] / self.phasor[reference])

    def scatter(self, channel: int) -> float:
        """Standard error of the tone in a channel, from the scatter of the parts, in the unit of the channel."""
        parts = self.parts[:, channel]
        return math.sqrt(float((abs(parts - parts.mean()) ** 2).sum()) / (len(parts) - 1) / len(parts))

    def error(self, channel: int) -> float:
        """The standard error of the tone in a channel as a fraction of the tone."""
        return self.scatter(channel) / max(float(abs(self.phasor[channel])), 1e-300)

    def coherence(self, channel: int, reference: int) -> float:
        """Magnitude-squared coherence of two channels at the tone, over the parts."""
        x, y = self.parts[:, reference], self.parts[:, channel]
        power = float((abs(x) ** 2).sum() * (abs(y) ** 2).sum())
        return float(abs((x.conj() * y).sum()) ** 2) / power if power else 0.0

    def drift(self, channel: int) -> float:
        """The pace of the converter's clock over the board's, less 1, by the phase over the parts of a channel.

        A converter that runs fast takes more samples of each period, so that the tone seems lower.
        """
        phase = np.unwrap(np.angle(self.parts[:, channel]))
        time_s = (np.arange(PARTS) + 0.5) * self.duration_s / PARTS
        slope = np.polyfit(time_s, phase, 1)[0]
        return float(-slope / (2 * np.pi * self.frequency_hz))

    def phase_step_rad(self, channel: int) -> float:
        """The greatest step of the phase between two parts beyond the even drift: large where samples are missing."""
        steps = np.diff(np.unwrap(np.angle(self.parts[:, channel])))
        return float(abs(steps - np.median(steps)).max())


def fit_tone(values: Array, sample_rate_hz: float, frequency_hz: float) -> ToneFit:
    """Fit a tone to samples (sample, channel) of finite values."""
    count = len(values)
    duration_s, time_s = count / sample_rate_hz, np.arange(count) / sample_rate_hz
    harmonics_hz = [k * frequency_hz for k in _HARMONICS if k * frequency_hz < sample_rate_hz / 2]
    hum_hz = hum_lines(frequency_hz, duration_s, harmonics_hz)
    lines_hz = np.array([frequency_hz, *harmonics_hz, *hum_hz])
    turns = 2 * np.pi * time_s[:, None] * lines_hz
    columns = np.hstack([np.cos(turns), np.sin(turns), np.ones((count, 1))])
    # Normal equations: the columns are nearly orthogonal, and there are thousands of rows.
    solution = np.linalg.solve(columns.T @ columns, columns.T @ values)
    lines = solution[: len(lines_hz)] - 1j * solution[len(lines_hz) : -1]
    rest = values - columns @ solution
    phasor, spin = lines[0], np.exp(-1j * turns[:, 0])
    edges = np.linspace(0, count, PARTS + 1).astype(int)
    parts = np.array(
        [
            phasor + 2 * (rest[start:stop] * spin[start:stop, None]).mean(axis=0)
            for start, stop in itertools.pairwise(edges)
        ]
    )
    after, none, noise = 1 + len(harmonics_hz), np.zeros(values.shape[1]), np.sqrt((rest**2).mean(axis=0))
    # Only a line that stands out of the noise by more than chance is hum.
    hum = abs(lines[after:]).max(axis=0) if hum_hz else none
    return ToneFit(
        frequency_hz=frequency_hz,
        duration_s=duration_s,
        phasor=phasor,
        parts=parts,
        hum=np.where(hum > _STANDS_OUT * noise * math.sqrt(2 / count), hum, 0.0),
        distortion=np.sqrt((abs(lines[1:after]) ** 2).sum(axis=0)) if harmonics_hz else none,
        rest=noise,
        mean=solution[-1],
    )


def hum_lines(frequency_hz: float, duration_s: float, others_hz: list[float]) -> list[float]:
    """Lines of the mains that a window of this length tells from the tone, from `others_hz` and from each other."""
    apart_hz, found = _RESOLVED / duration_s, list[float]()
    for mains_hz in MAINS_HZ:
        for line in range(1, HUM_LINES + 1):
            hz = line * mains_hz
            if all(abs(hz - other) > apart_hz for other in (frequency_hz, *others_hz, *found)):
                found.append(hz)
    return found


def is_beside_hum(frequency_hz: float, duration_s: float) -> bool:
    """Whether a line of the mains cannot be told from this tone in a window of this length."""
    apart_hz = _RESOLVED / duration_s
    return any(abs(frequency_hz - k * hz) <= apart_hz for hz in MAINS_HZ for k in range(1, HUM_LINES + 1))
