"""Windowed tones: the waveforms that a click is a sum of."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.device import Device
from precompute.model.damped_lines import DampedLines

Array = NDArray[np.float64]

PLAY_RATE_HZ = 4000.0
"""Of a waveform's samples; between them the device moves in straight lines."""
LOOKS = 2
"""Instants looked at for each sample: at 300 Hz a peak between them is missed by less than 0.06 dB."""
LOOK_RATE_HZ = LOOKS * PLAY_RATE_HZ
RING_S = 0.2
"""How long after the click's end the fingers are looked at."""
_ALIKE = 1e-3
_SIDE_LOBES = 33
"""Lines end this many 1 / length above the highest band: what the window spreads beyond is 2e-4 of the tone."""


@dataclass(frozen=True)
class Tones:
    """Windowed tones that a click is made of: wave (tone, time) at PLAY_RATE_HZ, and who plays each, actuator (tone,).

    Both ends of every wave are 0.
    """

    wave: Array
    actuator: NDArray[np.int64]

    def waveform(self, weight: Array) -> Array:
        """Base displacements (actuator, time), fractions of full scale, of the weights (tone,)."""
        actuators = int(self.actuator.max()) + 1
        return np.stack([weight[mine] @ self.wave[mine] for mine in (self.actuator == i for i in range(actuators))])


def make_tones(device: Device, length_s: float, crowding: float = 1.0) -> Tones:
    """Half-sine window of that length times cosines and sines in each actuator's band, `crowding` each 1 / length_s."""
    samples = round(length_s * PLAY_RATE_HZ)
    time_s = (np.arange(samples + 1) - samples / 2) / PLAY_RATE_HZ
    window = np.cos(np.pi * time_s / length_s)
    window[[0, -1]] = 0
    waves, players = list[Array](), list[int]()
    for index, actuator in enumerate(device.actuators):
        for tone_hz in _spread_over(actuator.band_hz, 1 / (crowding * length_s)):
            turn = 2 * np.pi * tone_hz * time_s
            waves += [window * np.cos(turn), window * np.sin(turn)]
            players += [index, index]
    return Tones(np.array(waves), np.array(players, dtype=np.int64))


def independent(tones: Tones) -> Tones:
    """Sums of them, orthogonal and as large as a tone; those that differ by nothing are left out.

    Crowded tones are nearly sums of one another, and programs over them ill-conditioned.
    """
    waves, players = list[Array](), list[NDArray[np.int64]]()
    for actuator in np.unique(tones.actuator):
        _, size, sums = np.linalg.svd(tones.wave[tones.actuator == actuator], full_matrices=False)
        kept = size > _ALIKE * size[0]
        waves.append(sums[kept] * size[0])
        players.append(np.full(np.count_nonzero(kept), actuator))
    wave = np.concatenate(waves)
    wave[:, [0, -1]] = 0  # where rounding leaves something
    return Tones(wave, np.concatenate(players))


def between(wave: Array) -> Array:
    """The same straight lines (..., time), sampled LOOKS times as often."""
    samples = wave.shape[-1]
    at = np.arange((samples - 1) * LOOKS + 1) / LOOKS
    left = np.minimum(at.astype(np.int64), samples - 2)
    part = at - left
    lines: Array = wave[..., left] * (1 - part) + wave[..., left + 1] * part
    return lines


def lines_for(device: Device, lengths_s: Sequence[float]) -> DampedLines:
    """Frequency lines for clicks of these lengths: of the longest with its ringing, up to what the shortest spreads."""
    band_hz = max(actuator.band_hz[1] for actuator in device.actuators)
    top_hz = min(band_hz + _SIDE_LOBES / min(lengths_s), 0.49 * PLAY_RATE_HZ)
    return DampedLines(PLAY_RATE_HZ, round((max(lengths_s) + RING_S) * PLAY_RATE_HZ), top_hz)


def _spread_over(band_hz: tuple[float, float], spacing_hz: float) -> Array:
    """Frequencies of that spacing in the middle of the band."""
    low_hz, high_hz = band_hz
    gaps = int((high_hz - low_hz) / spacing_hz * (1 + 1e-12))
    start_hz = (low_hz + high_hz - gaps * spacing_hz) / 2
    tones_hz: Array = start_hz + spacing_hz * np.arange(gaps + 1, dtype=np.float64)
    return tones_hz
