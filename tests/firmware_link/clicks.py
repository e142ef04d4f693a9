"""Waveforms of a test as clicks: each becomes a set of a basis that has one function for each actuator."""

from collections.abc import Sequence

import numpy as np

from base.arrays import Array
from firmware_link.protocol.basis import SAMPLE_FULL_SCALE, Basis, BasisSet, EncodedClick, encode_click
from firmware_link.protocol.messages import FULL_SCALE_WORD, Play

FRACTION_BITS = 14


class Clicks:
    """Waveforms (sample, actuator) in fractions of full scale, by index, and the basis of which they are."""

    def __init__(self, sample_rate_hz: int, waveforms: Sequence[Array]) -> None:
        peaks = [np.abs(waveform).max(axis=0) for waveform in waveforms]
        self.weights = [tuple(np.rint(peak * 2**FRACTION_BITS).astype(int).tolist()) for peak in peaks]
        self.basis = Basis(
            sample_rate_hz,
            tuple(
                BasisSet(
                    np.rint(SAMPLE_FULL_SCALE * waveform.T / np.maximum(peak, 1e-9)[:, None]).astype(np.int16),
                    np.arange(len(peak), dtype=np.uint8),
                )
                for waveform, peak in zip(waveforms, peaks, strict=True)
            ),
        )

    def play(self, index: int, clock_reference: int, amplitude: int = FULL_SCALE_WORD) -> Play:
        """The PLAY of one of them; one beyond the last is that of a set that is not there."""
        weights = self.weights[min(index, len(self.weights) - 1)]
        return Play(clock_reference, index, FRACTION_BITS, amplitude, len(weights), weights)

    def encoded(self, index: int, amplitude: float = 1.0) -> EncodedClick:
        """One of them as a link takes it."""
        return encode_click(self.basis, index, self.weights[index], FRACTION_BITS, amplitude)
