"""A click that was solved beside a run, read from the PLAY that carried it: weights of the basis of the run's table."""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from firmware_link.protocol.basis import Basis, weighted_sum
from firmware_link.protocol.messages import FULL_SCALE_WORD, Play, decode_body, encode_play_body


@dataclass(frozen=True, eq=False)
class SolvedClick:
    """Weights (function,) of a set of a basis, in steps of 2^-fraction_bits, played at a fraction of full scale."""

    basis: Basis
    basis_set: int
    weights: NDArray[np.int16]
    fraction_bits: int
    amplitude: float
    actuators: int

    @classmethod
    def of(cls, play: bytes, basis: Basis | None, actuators: int, halvings: int = 0) -> Self | None:
        """The click of a PLAY without its clock reference; None for one of a set that the basis does not have.

        halvings: how many times the functions of the board's basis are halved.
        """
        if basis is None or not play:
            return None
        _, message = decode_body(encode_play_body(0, play, 0))
        assert isinstance(message, Play)
        if message.basis_set >= len(basis.sets) or len(basis.sets[message.basis_set].actuators) != len(message.weights):
            return None
        weights, amplitude = np.array(message.weights, dtype=np.int16), message.amplitude / FULL_SCALE_WORD
        return cls(basis, message.basis_set, weights, message.fraction_bits + halvings, amplitude, actuators)

    @cached_property
    def samples(self) -> NDArray[np.int16]:
        """Base displacement (sample, actuator) at full amplitude, as the device plays it."""
        sums = weighted_sum(self.basis.sets[self.basis_set], self.weights, self.fraction_bits, self.actuators)
        limits = np.iinfo(np.int16)
        return np.clip(sums, limits.min, limits.max).astype(np.int16)

    @property
    def length_s(self) -> float:
        """Length of the waveform."""
        return (self.basis.sets[self.basis_set].samples - 1) / self.basis.sample_rate_hz
