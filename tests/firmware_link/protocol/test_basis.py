"""Laws of the bases: bytes and back, bytes that are not a basis are refused, and what weights become."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from firmware_link.protocol.basis import (
    SAMPLE_FULL_SCALE,
    Basis,
    BasisSet,
    clamp_samples,
    decode_basis,
    encode_basis,
    encode_click,
    hash_of_basis,
    quantise_weights,
    sample_limits,
)
from firmware_link.protocol.link_errors import MessageError
from firmware_link.protocol.messages import FULL_SCALE_WORD, MAXIMUM_WEIGHTS
from tests.firmware_link.strategies import bases, unhurried

ACTUATORS = 3  # as in `bases`
SILENCE = BasisSet(np.zeros((1, 2), np.int16), np.zeros(1, np.uint8))


def of_one(functions: int = 1, samples: int = 2, value: int = 0) -> BasisSet:
    return BasisSet(np.full((functions, samples), value, np.int16), np.zeros(functions, np.uint8))


@unhurried
@given(bases())
def test_a_basis_survives_its_bytes_and_is_refused_by_a_device_of_fewer_actuators(basis: Basis) -> None:
    decoded = decode_basis(encode_basis(basis), ACTUATORS)
    assert decoded.sample_rate_hz == basis.sample_rate_hz
    for got, sent in zip(decoded.sets, basis.sets, strict=True):
        np.testing.assert_array_equal(got.functions, sent.functions)
        np.testing.assert_array_equal(got.actuators, sent.actuators)
    with pytest.raises(MessageError, match=f"for {basis.number_of_actuators} actuators, not"):
        decode_basis(encode_basis(basis), basis.number_of_actuators - 1)


@unhurried
@given(st.binary(max_size=200), st.integers(1, 4))
def test_any_bytes_are_a_basis_or_refused(data: bytes, number_of_actuators: int) -> None:
    try:
        basis = decode_basis(data, number_of_actuators)
    except MessageError:
        return
    assert encode_basis(basis) == data


@pytest.mark.parametrize(
    ("sample_rate_hz", "sets", "reason"),
    [
        (0, (SILENCE,), "0 Hz; expected 1 to 65535"),
        (1000, (), "0 sets"),
        (1000, (of_one(samples=1),), "set 0 has 1 samples"),
        (1000, (SILENCE, of_one(value=1)), "set 1 of a basis has a function that does not begin and end at 0"),
        (1000, (of_one(MAXIMUM_WEIGHTS + 1),), "has 256 functions, a PLAY carries 1 to 255: take shorter clicks"),
        (1000, (BasisSet(np.zeros((2, 2), np.int16), np.zeros(1, np.uint8)),), "2 functions for 1 actuators"),
    ],
)
def test_a_basis_that_no_device_takes_is_refused(sample_rate_hz: int, sets: tuple[BasisSet, ...], reason: str) -> None:
    with pytest.raises(MessageError, match=reason):
        Basis(sample_rate_hz, sets)


def test_a_length_is_rounded_up_and_no_basis_has_the_hash_0() -> None:
    assert Basis(3000, (of_one(samples=3),)).length_us(0) == 667
    # The four bytes whose CRC-32 is 0.
    assert hash_of_basis(bytes.fromhex("9d0ad96d")) == 1


def test_a_click_that_does_not_fit_its_set_is_refused() -> None:
    basis = Basis(1000, (of_one(3), of_one(MAXIMUM_WEIGHTS)))
    assert encode_click(basis, 0, 3 * [1], 31).play and encode_click(basis, 0, 3 * [1], 1).play
    for weights, fraction_bits in ((2 * [1], 14), (3 * [1], 0), (3 * [1], 32)):
        with pytest.raises(MessageError, match="expected 3 weights, and 1 to 31 bits"):
            encode_click(basis, 0, weights, fraction_bits)
    for weights, amplitude in ((3 * [40_000], 1.0), (3 * [1], 1.5)):
        with pytest.raises(MessageError):
            encode_click(basis, 0, weights, 14, amplitude)


@given(st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=50))
@example([SAMPLE_FULL_SCALE / 2**14])
def test_weights_are_words_of_the_finest_step_that_has_room_or_are_refused(weights: list[float]) -> None:
    words, fraction_bits = quantise_weights(np.array(weights))
    np.testing.assert_allclose(words / 2**fraction_bits, weights, rtol=0, atol=0.5 / 2**fraction_bits)
    assert fraction_bits == 31 or max(map(abs, weights)) * 2 ** (fraction_bits + 1) > SAMPLE_FULL_SCALE
    with pytest.raises(MessageError, match="20000; expected at most"):
        quantise_weights(np.array([*weights, 20_000.0]))


@unhurried
@given(
    st.integers(0, 2**32),
    st.integers(2, 300),
    st.lists(st.integers(0, FULL_SCALE_WORD), min_size=2, max_size=2),
    st.integers(0, 2**32 - 1),
    st.integers(1, 65_535),
)
def test_no_sums_pass_amplitude_or_step_and_all_end_at_0(
    seed: int, samples: int, limits: list[int], highest_uhz: int, rate_hz: int
) -> None:
    noise = np.random.default_rng(seed)
    sums = noise.integers(-(10 ** noise.integers(1, 9)), 10 ** noise.integers(1, 9), (samples, 2))
    bounds = sample_limits(limits, highest_uhz, rate_hz)
    played = clamp_samples(sums, bounds).astype(np.int64)
    assert (np.abs(played) <= bounds.amplitude).all()
    assert (np.abs(np.diff(played, axis=0)) <= bounds.step).all()
    assert not played[[0, -1]].any()
