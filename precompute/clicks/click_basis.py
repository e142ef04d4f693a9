"""Basis of clicks: tones under a half-sine window, of which every click is a weighted sum.

Clicks are solved in the very functions that the device holds, rounded to its samples, so nothing but the weights is
rounded afterwards. The basis depends on the actuators' bands and on the options' lengths and crowding, not on the bar.
"""

from dataclasses import dataclass

import numpy as np

from base.arrays import Array, Integers
from engine.device import Device
from firmware_link.protocol.basis import SAMPLE_FULL_SCALE, Basis, BasisSet
from precompute.clicks.click_options import ClickOptions
from precompute.model.damped_lines import DampedLines

SAMPLE_RATE_HZ = 4000.0  # sample rate of a waveform; between samples the displacement is linear
EVALUATIONS_PER_SAMPLE = 2  # instants of the response for each sample: a peak at 300 Hz is missed by < 0.06 dB
EVALUATION_RATE_HZ = EVALUATIONS_PER_SAMPLE * SAMPLE_RATE_HZ
RINGDOWN_S = 0.08
"""Time after the end of a click over which the fingers are evaluated.

Levels of clicks differ by 0.01 dB in the mean from those over 0.38 s, on three bars and on ones of a quarter of their
damping.
"""
_NEGLIGIBLE = 1e-3  # singular value, relative to the greatest, below which a combination of tones is dropped
_SIDE_LOBES = 21
"""Multiples of 1 / length above the highest band at which the lines end: beyond, a tone has 6e-4 of its amplitude.

Half as many again change the level of a click by up to 0.1 dB.
"""


@dataclass(frozen=True)
class Tones:
    """Windowed tones: wave (tone, time) at SAMPLE_RATE_HZ, 0 at both ends, and the actuator (tone,) that plays each."""

    wave: Array
    actuator: Integers

    def waveform(self, weight: Array) -> Array:
        """Base displacements (actuator, time) in fractions of full scale from weights (tone,)."""
        actuators = int(self.actuator.max()) + 1
        return np.stack([weight[mine] @ self.wave[mine] for mine in (self.actuator == i for i in range(actuators))])


def make_tones(device: Device, length_s: float, crowding: float = 1.0) -> Tones:
    """Cosines and sines in each actuator's band under a half-sine window, spaced by 1 / (crowding * length_s)."""
    samples = round(length_s * SAMPLE_RATE_HZ)
    time_s = (np.arange(samples + 1) - samples / 2) / SAMPLE_RATE_HZ
    window = np.cos(np.pi * time_s / length_s)
    window[[0, -1]] = 0
    waves, players = list[Array](), list[int]()
    for index, actuator in enumerate(device.actuators):
        for tone_hz in _spread_over(actuator.band_hz, 1 / (crowding * length_s)):
            turn = 2 * np.pi * tone_hz * time_s
            waves += [window * np.cos(turn), window * np.sin(turn)]
            players += [index, index]
    return Tones(np.array(waves), np.array(players, dtype=np.int64))


def orthogonalised(tones: Tones) -> Tones:
    """Orthogonal combinations of the tones, without negligible ones.

    Closely spaced tones are nearly linearly dependent, which would make the linear programs ill-conditioned.
    """
    waves, players = list[Array](), list[Integers]()
    for actuator in np.unique(tones.actuator):
        _, size, sums = np.linalg.svd(tones.wave[tones.actuator == actuator], full_matrices=False)
        kept = size > _NEGLIGIBLE * size[0]
        waves.append(sums[kept] * size[0])
        players.append(np.full(np.count_nonzero(kept), actuator))
    wave = np.concatenate(waves)
    wave[:, [0, -1]] = 0  # rounding leaves them near 0
    return Tones(wave, np.concatenate(players))


def click_basis(device: Device, options: ClickOptions) -> Basis:
    """The basis of all clicks of a device, of one set. Raises MessageError for more functions than a PLAY carries."""
    return Basis(round(SAMPLE_RATE_HZ), (click_set(device, options.length_s, options.crowding),))


def click_set(device: Device, length_s: float, crowding: float) -> BasisSet:
    """Functions of clicks of one length: orthogonal tones, each with its peak at full scale, rounded to samples."""
    tones = orthogonalised(make_tones(device, length_s, crowding))
    wave = tones.wave / np.abs(tones.wave).max(axis=1, keepdims=True)
    return BasisSet(np.rint(SAMPLE_FULL_SCALE * wave).astype(np.int16), tones.actuator.astype(np.uint8))


def tones_of(basis_set: BasisSet) -> Tones:
    """The functions of a set as tones, in fractions of full scale."""
    return Tones(basis_set.functions / SAMPLE_FULL_SCALE, basis_set.actuators.astype(np.int64))


def interpolated(wave: Array) -> Array:
    """Waveforms (..., time) interpolated linearly at EVALUATION_RATE_HZ."""
    samples = wave.shape[-1]
    at = np.arange((samples - 1) * EVALUATIONS_PER_SAMPLE + 1) / EVALUATIONS_PER_SAMPLE
    left = np.minimum(at.astype(np.int64), samples - 2)
    part = at - left
    return wave[..., left] * (1 - part) + wave[..., left + 1] * part


def drive_rows(tones: Tones, amplitude: float) -> Array:
    """Rows (row, tone) whose magnitude is at most 1 where displacements keep to the amplitude."""
    actuators: list[int] = np.unique(tones.actuator).tolist()
    rows = [(tones.wave * (tones.actuator == actuator)[:, None]).T[1:-1] for actuator in actuators]
    return np.concatenate(rows) / amplitude  # the window is 0 at both ends


def lines_for(device: Device, length_s: float) -> DampedLines:
    """Frequency lines for clicks of this length and their ringing."""
    band_hz = max(actuator.band_hz[1] for actuator in device.actuators)
    top_hz = min(band_hz + _SIDE_LOBES / length_s, 0.49 * SAMPLE_RATE_HZ)
    return DampedLines(SAMPLE_RATE_HZ, round((length_s + RINGDOWN_S) * SAMPLE_RATE_HZ), top_hz)


def _spread_over(band_hz: tuple[float, float], spacing_hz: float) -> Array:
    """Frequencies of that spacing, centred in the band."""
    low_hz, high_hz = band_hz
    gaps = int((high_hz - low_hz) / spacing_hz * (1 + 1e-12))
    start_hz = (low_hz + high_hz - gaps * spacing_hz) / 2
    return start_hz + spacing_hz * np.arange(gaps + 1, dtype=np.float64)
