"""Weights of a click to the words that travel, and the waveform that the device makes of them.

The program gives weights for which displacements just reach the limits. Rounding moves a displacement by up to a few
steps of a sample, and what passes the amplitude limit the device would clamp. So the weights are scaled down by as much
as their words pass a limit (some 1e-4, or 0.001 dB) until no sample does: then the waveform is the plain sum.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from base.arrays import Array
from firmware_link.protocol.basis import SAMPLE_FULL_SCALE, BasisSet, amplitude_steps, quantise_weights, weighted_sum

_MARGIN = 2 / SAMPLE_FULL_SCALE


@dataclass(frozen=True)
class QuantisedWeights:
    """Weights (function,) in steps of 2^-fraction_bits, and their base displacements (actuator, time)."""

    words: NDArray[np.int16]
    fraction_bits: int
    waveform: Array


def quantise(basis_set: BasisSet, weight: Array, amplitude: float) -> QuantisedWeights:
    """Round weights (function,); no sample passes the amplitude."""
    most_steps = amplitude_steps(amplitude)
    while True:
        words, fraction_bits = quantise_weights(weight)
        sums = weighted_sum(basis_set, words, fraction_bits, basis_set.number_of_actuators)
        passed = np.abs(sums).max() / most_steps
        if passed <= 1:
            return QuantisedWeights(words, fraction_bits, sums.T / SAMPLE_FULL_SCALE)
        weight = weight * ((1 - _MARGIN) / passed)
