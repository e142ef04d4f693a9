"""Basis of clicks: the functions of which every click is a weighted sum, as bytes for a device and as waveforms.

Theory of operation
-------------------
A click is a short waveform for each actuator, and all clicks of a device are weighted sums of the same functions. The
device is given the functions once; a PLAY then carries the weights only, some 40 numbers. A basis has one set of
functions for each length of clicks. Each function moves one actuator, is sampled at the basis' rate, and is 0 at both
ends; its samples are int16, SAMPLE_FULL_SCALE is full scale.

The waveform of a PLAY is defined in integers, so that host, emulator and firmware have the same samples bit for bit:

1. sum: (sum of weight times sample + 2^(fraction_bits - 1)) / 2^fraction_bits, rounded down, for each actuator;
2. the sum is clamped to the amplitude limit, and before the end to what can still return to 0 in time: `step` times the
   number of samples that remain;
3. its change from one sample to the next is clamped to `step`. After 2. this moves no sample beyond its bounds, since
   the bounds themselves fall by no more than a step; so every waveform ends at 0 whatever its weights are.

`step` is the greatest change of a sine with the highest frequency of the device and the amplitude limit. A click whose
tones are below that frequency and whose amplitude is within the limit never meets it (Bernstein's inequality). Any
other weights become a waveform that a SET could have asked for.
"""

import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from base.arrays import Array, Integers
from firmware_link.protocol import drive_words, messages
from firmware_link.protocol.link_errors import MessageError

US_PER_S = 1_000_000
SAMPLE_FULL_SCALE = 32_767  # the greatest int16, for either sign
SHORTEST_WAVEFORM = 2
MAXIMUM_SETS = 256
_WEIGHT_MAXIMUM = 32_767  # the greatest int16; fraction_bits give the scale
_HEAD, _SET_HEAD = struct.Struct("<HH"), struct.Struct("<HH")
_LONGEST_WAVEFORM = 0xFFFF  # a u16 counts the samples
_HASH_INSTEAD_OF_0 = 1  # a hash of 0 means that no basis is held
_TURN_NUMERATOR, _TURN_DENOMINATOR = 710, 113  # 2 pi as a fraction of small integers, 9e-8 too great

Samples = NDArray[np.int16]


@dataclass(frozen=True, eq=False)
class BasisSet:
    """Functions (function, sample) of clicks of one length, and the actuator (function,) that each moves."""

    functions: Samples
    actuators: NDArray[np.uint8]

    @property
    def samples(self) -> int:
        """Number of samples of each function."""
        return int(self.functions.shape[1])

    @property
    def number_of_actuators(self) -> int:
        """Number of the last actuator that any function moves, counted from 1."""
        return 1 + int(self.actuators.max())


@dataclass(frozen=True, eq=False)
class Basis:
    """Sets of functions at one rate; raises MessageError for sets that no device would take."""

    sample_rate_hz: int
    sets: tuple[BasisSet, ...]

    def __post_init__(self) -> None:
        if not 1 <= self.sample_rate_hz <= 0xFFFF:
            raise MessageError(f"the sample rate of a basis is {self.sample_rate_hz} Hz; expected 1 to 65535")
        if not 1 <= len(self.sets) <= MAXIMUM_SETS:
            raise MessageError(f"a basis has {len(self.sets)} sets; expected 1 to {MAXIMUM_SETS}")
        for index, each in enumerate(self.sets):
            _check_set(index, each)

    @property
    def number_of_actuators(self) -> int:
        """Number of the last actuator that any function moves, counted from 1."""
        return max(each.number_of_actuators for each in self.sets)

    @cached_property
    def data(self) -> bytes:
        """The bytes that a device holds."""
        return encode_basis(self)

    @cached_property
    def hash(self) -> int:
        """The hash that names these bytes."""
        return hash_of_basis(self.data)

    def length_us(self, index: int) -> int:
        """Duration of the clicks of a set, rounded up."""
        return -(-(self.sets[index].samples - 1) * US_PER_S // self.sample_rate_hz)


class EncodedClick(NamedTuple):
    """A click as a PLAY carries it, encoded once ahead of time."""

    play: bytes  # all of the body behind the clock reference
    length_us: int
    amplitude: int  # a word
    basis_hash: int


class SampleLimits(NamedTuple):
    """The bounds of a waveform by actuator, in steps of its samples: magnitude, and change from sample to sample."""

    amplitude: Integers
    step: Integers


def encode_click(
    basis: Basis, basis_set: int, weights: Sequence[int], fraction_bits: int, amplitude: float = 1.0
) -> EncodedClick:
    """The click of these weights; raises MessageError where they do not fit the set."""
    functions = len(basis.sets[basis_set].actuators)
    if len(weights) != functions or not 1 <= fraction_bits <= messages.MAXIMUM_FRACTION_BITS:
        raise MessageError(
            f"{len(weights)} weights with {fraction_bits} fraction bits for set {basis_set} of a basis; expected "
            f"{functions} weights, and 1 to {messages.MAXIMUM_FRACTION_BITS} bits"
        )
    word = drive_words.encode_amplitude(amplitude)
    return EncodedClick(
        messages.encode_play(basis_set, fraction_bits, word, weights), basis.length_us(basis_set), word, basis.hash
    )


def quantise_weights(weights: Array) -> tuple[NDArray[np.int16], int]:
    """Weights as words and their fraction bits: as many as the greatest weight leaves room for."""
    greatest = float(np.abs(weights).max())
    for fraction_bits in range(messages.MAXIMUM_FRACTION_BITS, 0, -1):
        if round(greatest * 2**fraction_bits) <= _WEIGHT_MAXIMUM:
            return np.rint(weights * 2**fraction_bits).astype(np.int16), fraction_bits
    raise MessageError(f"a weight of a click is {greatest:g}; expected at most {_WEIGHT_MAXIMUM / 2:g}")


def weighted_sum(
    basis_set: BasisSet, weights: Sequence[int] | NDArray[np.int16], fraction_bits: int, number_of_actuators: int
) -> Integers:
    """The sum of step 1 (sample, actuator), before it is clamped."""
    words = np.asarray(weights, dtype=np.int64)
    sums = np.zeros((basis_set.samples, number_of_actuators), dtype=np.int64)
    for actuator in np.unique(basis_set.actuators).tolist():
        mine = basis_set.actuators == actuator
        sums[:, actuator] = words[mine] @ basis_set.functions[mine].astype(np.int64)
    return (sums + (1 << (fraction_bits - 1))) >> fraction_bits


def sample_limits(amplitude_limits: Sequence[int], frequency_maximum_uhz: int, sample_rate_hz: int) -> SampleLimits:
    """The bounds of clicks at this rate, from the amplitude limits (words) and the highest frequency of the device."""
    amplitude = [_steps_of(limit) for limit in amplitude_limits]
    a_turn = _TURN_DENOMINATOR * sample_rate_hz * US_PER_S
    step = [-(-limit * frequency_maximum_uhz * _TURN_NUMERATOR // a_turn) for limit in amplitude]
    return SampleLimits(np.array(amplitude, dtype=np.int64), np.array(step, dtype=np.int64))


def amplitude_steps(amplitude: float) -> int:
    """The bound of samples that an amplitude limit, in fractions of full scale, sets."""
    return _steps_of(drive_words.encode_amplitude(amplitude))


def clamp_samples(sums: Integers, limits: SampleLimits) -> Samples:
    """The waveform (sample, actuator) that is played, of the sums (steps 2 and 3)."""
    remaining = np.arange(len(sums) - 1, -1, -1)[:, None]
    bound = np.minimum(limits.amplitude, limits.step * remaining)
    samples = np.clip(sums, -bound, bound)
    samples[0] = 0
    if (np.abs(np.diff(samples, axis=0)) > limits.step).any():
        for at in range(1, len(samples)):
            samples[at] = np.clip(samples[at], samples[at - 1] - limits.step, samples[at - 1] + limits.step)
    return samples.astype(np.int16)


def encode_basis(basis: Basis) -> bytes:
    """Bytes of a basis."""
    heads = (_SET_HEAD.pack(each.samples, len(each.actuators)) for each in basis.sets)
    bodies = (each.actuators.tobytes() + each.functions.T.astype("<i2").tobytes() for each in basis.sets)
    return _HEAD.pack(basis.sample_rate_hz, len(basis.sets)) + b"".join(heads) + b"".join(bodies)


def decode_basis(data: bytes, number_of_actuators: int) -> Basis:
    """Basis of its bytes; raises MessageError for bytes that are not a basis for this number of actuators."""
    try:
        sample_rate_hz, number = _HEAD.unpack_from(data)
        heads = [_SET_HEAD.unpack_from(data, _HEAD.size + _SET_HEAD.size * index) for index in range(number)]
    except struct.error as error:
        raise MessageError(f"a basis of {len(data)} bytes ends within its head: {error}") from error
    at, sets = _HEAD.size + _SET_HEAD.size * number, []
    for samples, functions in heads:
        body = data[at : at + functions * (1 + 2 * samples)]
        at += functions * (1 + 2 * samples)
        if at > len(data):
            break
        table = np.frombuffer(body[functions:], "<i2").astype(np.int16).reshape(samples, functions)
        sets.append(BasisSet(np.ascontiguousarray(table.T), np.frombuffer(body[:functions], np.uint8)))
    if at != len(data):
        raise MessageError(f"a basis of {number} sets has {len(data)} bytes; expected {at}")
    basis = Basis(sample_rate_hz, tuple(sets))
    check_actuators(basis, number_of_actuators)
    return basis


def check_actuators(basis: Basis, number_of_actuators: int) -> None:
    """Raises MessageError for a basis that moves actuators beyond these."""
    if basis.number_of_actuators > number_of_actuators:
        raise MessageError(f"a basis is for {basis.number_of_actuators} actuators, not {number_of_actuators}")


def hash_of_basis(data: bytes) -> int:
    """Hash that names the bytes of a basis; never 0."""
    return zlib.crc32(data) or _HASH_INSTEAD_OF_0


def transfer_messages(data: bytes) -> Iterator[messages.BasisBegin | messages.BasisChunk | messages.BasisCommit]:
    """Messages that transfer a basis, in order; each must be acknowledged before the next."""
    basis_hash = hash_of_basis(data)
    yield messages.BasisBegin(basis_hash, len(data))
    for offset in range(0, len(data), messages.BASIS_CHUNK_SIZE):
        yield messages.BasisChunk(
            offset, data[offset : offset + messages.BASIS_CHUNK_SIZE].ljust(messages.BASIS_CHUNK_SIZE, b"\0")
        )
    yield messages.BasisCommit(basis_hash)


def _steps_of(amplitude_limit: int) -> int:
    return amplitude_limit * SAMPLE_FULL_SCALE // messages.FULL_SCALE_WORD


def _check_set(index: int, basis_set: BasisSet) -> None:
    functions, samples = basis_set.functions.shape
    if not 1 <= functions <= messages.MAXIMUM_WEIGHTS:
        raise MessageError(
            f"set {index} of a basis has {functions} functions, a PLAY carries 1 to {messages.MAXIMUM_WEIGHTS}: take "
            "shorter clicks, or tones that are less crowded"
        )
    if not SHORTEST_WAVEFORM <= samples <= _LONGEST_WAVEFORM:
        raise MessageError(f"set {index} has {samples} samples; expected {SHORTEST_WAVEFORM} to {_LONGEST_WAVEFORM}")
    if len(basis_set.actuators) != functions:
        raise MessageError(f"set {index} of a basis has {functions} functions for {len(basis_set.actuators)} actuators")
    if basis_set.functions[:, [0, -1]].any():
        raise MessageError(f"set {index} of a basis has a function that does not begin and end at 0")
