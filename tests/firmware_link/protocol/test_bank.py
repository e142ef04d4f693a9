"""Laws of the banks: bytes and back, and bytes that are not a bank are refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_link.protocol.bank import (
    Bank,
    decode_bank,
    encode_bank,
    hash_of_bank,
    make_bank,
)
from firmware_link.protocol.errors import MessageError
from tests.firmware_link.strategies import banks, unhurried

ACTUATORS = 3  # as in `banks`


@unhurried
@given(banks())
def test_a_bank_survives_its_bytes(bank: Bank) -> None:
    decoded = decode_bank(encode_bank(bank, ACTUATORS), ACTUATORS)
    assert decoded.sample_rate_hz == bank.sample_rate_hz
    for got, sent in zip(decoded.waveforms, bank.waveforms, strict=True):
        np.testing.assert_array_equal(got, sent)


@unhurried
@given(banks(), st.integers(1, 3))
def test_spare_actuators_of_a_device_are_silent(bank: Bank, spare: int) -> None:
    decoded = decode_bank(encode_bank(bank, ACTUATORS + spare), ACTUATORS + spare)
    assert not any(waveform[:, ACTUATORS:].any() for waveform in decoded.waveforms)


@unhurried
@given(st.binary(max_size=200), st.integers(1, 4))
def test_any_bytes_are_a_bank_or_refused(data: bytes, number_of_actuators: int) -> None:
    try:
        bank = decode_bank(data, number_of_actuators)
    except MessageError:
        return
    assert encode_bank(bank, number_of_actuators) == data


@pytest.mark.parametrize(
    ("bank", "reason"),
    [
        (Bank(0, (np.zeros((2, 1), np.int16),)), "0 Hz; expected 1 to 65535"),
        (Bank(1000, ()), "0 waveforms"),
        (Bank(1000, (np.zeros((1, 1), np.int16),)), "waveform 0 has 1 samples"),
        (Bank(1000, (np.ones((2, 1), np.int16),)), "waveform 0 does not begin and end at 0"),
        (Bank(1000, (np.zeros((2, 5), np.int16),)), "for 5 actuators, not 3"),
    ],
)
def test_a_bank_that_no_device_takes_is_refused_with_its_reason(bank: Bank, reason: str) -> None:
    with pytest.raises(MessageError, match=reason):
        encode_bank(bank, ACTUATORS)


def test_a_waveform_beyond_full_scale_is_refused() -> None:
    with pytest.raises(MessageError, match=r"reaches 1\.5 of full scale"):
        make_bank(1000, [np.array([[0.0], [-1.5], [0.0]])])


def test_a_length_is_rounded_up() -> None:
    assert make_bank(3000, [np.zeros((3, 1))]).length_us(0) == 667


def test_no_bank_has_the_hash_0() -> None:
    # The four bytes whose CRC-32 is 0.
    assert hash_of_bank(bytes.fromhex("9d0ad96d")) == 1
