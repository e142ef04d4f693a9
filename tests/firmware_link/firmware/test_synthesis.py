"""Laws of the C synthesis: pure tones that keep their angle, and never more than limit and slew allow."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_link.protocol.basis import Basis, BasisSet, clamp_samples, sample_limits, transfer_messages, weighted_sum
from firmware_link.protocol.drive_words import ChannelDrive, encode_drive
from firmware_link.protocol.messages import (
    BASIS_CHUNK_SIZE,
    FULL_SCALE_WORD,
    MAXIMUM_WEIGHTS,
    BasisBegin,
    BasisChunk,
    Play,
    Set,
    SetFlag,
)
from tests.firmware_link.firmware.compiled_core import FULL_OUTPUT, US_PER_S, Played
from tests.firmware_link.firmware.measure_synthesis import measure
from tests.firmware_link.law_host import Clicks, greeting
from tests.firmware_link.strategies import RESOLUTION_HZ, unhurried
from tests.firmware_link.virtual_rig import reference

RATE_HZ = 20_000
ACTUATORS = 2
GREATEST_FREQUENCY_HZ = 655.35
ROUNDING = 1 / FULL_OUTPUT

drives = st.tuples(
    *[
        st.builds(
            ChannelDrive, st.floats(1, GREATEST_FREQUENCY_HZ), st.sampled_from([0.0, 0.2, 1.0]), st.floats(0, math.tau)
        )
    ]
    * ACTUATORS
)
commands = st.lists(
    st.tuples(st.integers(0, 30_000), drives, st.sampled_from([SetFlag(0), SetFlag.WRITE_PHASE])), max_size=10
)


@pytest.mark.parametrize("rate_hz", [8_000, 48_000])
@pytest.mark.parametrize("frequency_hz", [60.0, 187.33, 655.35])  # at 48 kHz the second lies 0.66 steps above one
def test_a_tone_is_pure_and_both_channels_keep_their_angle(rate_hz: int, frequency_hz: float) -> None:
    quality = measure(rate_hz, frequency_hz, 1.0, 1.0)
    # Half a step of the 32-bit phase, and what the fit itself is off by.
    assert abs(quality.frequency_error_uhz) <= 1e6 * rate_hz / 2**33 + 0.5
    assert quality.spurious_db < -105
    assert quality.phase_error_rad < 1e-6
    assert quality.amplitude_error < 1e-5


@unhurried
@given(commands, st.tuples(*[st.integers(0, FULL_SCALE_WORD)] * ACTUATORS), st.sampled_from([1, 20, 200, 1_000]))
def test_nothing_passes_the_limit_or_moves_faster_than_the_slew(
    given_commands: list[tuple[int, tuple[ChannelDrive, ...], SetFlag]], limits: tuple[int, ...], slew_per_s: int
) -> None:
    device = Played(RATE_HZ, limits, slew_per_s)
    for wait_us, channels, flags in given_commands:
        device.send(Set(reference(device.now_us), flags, 40, encode_drive(channels, RESOLUTION_HZ)))
        device.wait(wait_us)
    device.wait(100_000)
    samples = device.take() / FULL_OUTPUT
    bounds = np.array(limits) / FULL_SCALE_WORD
    assert (np.abs(samples).max(axis=0, initial=0.0) <= bounds + ROUNDING).all()
    fastest_per_s = math.tau * GREATEST_FREQUENCY_HZ * bounds + slew_per_s
    assert (np.abs(np.diff(samples, axis=0)).max(axis=0, initial=0.0) <= fastest_per_s / RATE_HZ + 2 * ROUNDING).all()
    # From rest, whatever was asked for.
    rise = np.arange(len(samples))[:, None] * slew_per_s / RATE_HZ
    assert (np.abs(samples) <= rise + ROUNDING).all()


@unhurried
@given(
    st.integers(0, 2**32),
    st.integers(1, MAXIMUM_WEIGHTS),
    st.integers(1, 31),
    st.tuples(*[st.sampled_from([0, 1, 20_000, FULL_SCALE_WORD])] * ACTUATORS),
    st.sampled_from([1, 7, 40, 200]),
)
def test_a_click_is_what_its_weights_are_defined_to_be_bit_for_bit(
    seed: int, functions: int, fraction_bits: int, limits: tuple[int, ...], crowding: int
) -> None:
    noise = np.random.default_rng(seed)
    wave = np.cumsum(noise.normal(size=(functions, 200 * crowding)), axis=1)[:, ::crowding]
    wave *= np.sin(np.linspace(0, np.pi, 200)) / np.abs(wave).max()
    wave[:, [0, -1]] = 0
    each = BasisSet(
        np.rint(FULL_OUTPUT * wave).astype(np.int16), noise.integers(0, ACTUATORS, functions).astype(np.uint8)
    )
    most = 2 ** min(fraction_bits, 15)  # so that limits do not cut all of it, and many sums of few bits have no rest
    weights = noise.integers(-most, most - 1, functions, endpoint=True).tolist()
    device = Played(RATE_HZ, limits, 200, Basis(RATE_HZ, (each,)))
    play = Play(reference(device.now_us), 0, fraction_bits, FULL_SCALE_WORD, functions, tuple(weights))
    device.send(play)
    device.wait(200 * US_PER_S // RATE_HZ)
    bounds = sample_limits(limits, round(GREATEST_FREQUENCY_HZ * 1_000_000), RATE_HZ)
    wanted = clamp_samples(weighted_sum(each, weights, fraction_bits, ACTUATORS), bounds)
    np.testing.assert_array_equal(device.take(), wanted)


@unhurried
@given(st.integers(0, 8_000), st.sampled_from([8_000, 20_000, 48_000]), drives.map(lambda pair: pair[0]))
def test_all_channels_start_on_one_sample(wait_us: int, rate_hz: int, drive: ChannelDrive) -> None:
    """What is asked of both is the same, by PLAY and by SET: so are all samples of both, from the first on."""
    hump = np.sin(np.linspace(0, np.pi, 100))
    clicks = Clicks(rate_hz, [np.outer(hump, [1.0, 1.0])])
    for is_click in (True, False):
        device = Played(rate_hz, (FULL_SCALE_WORD,) * ACTUATORS, 200, clicks.basis)
        device.wait(wait_us)
        now = reference(device.now_us)
        steady = encode_drive((drive,) * ACTUATORS, RESOLUTION_HZ)
        device.send(clicks.play(0, now) if is_click else Set(now, SetFlag.WRITE_PHASE, 40, steady))
        device.wait(30_000)
        left, right = device.take().T
        assert left.any() or not (is_click or drive.amplitude)
        np.testing.assert_array_equal(left, right)


def test_a_click_whose_basis_goes_stands_still_and_fades_on() -> None:
    ramp = np.minimum(np.arange(400), np.arange(400)[::-1]) / 327.67
    clicks = Clicks(RATE_HZ, [np.outer(ramp, [1.0, -1.0])])
    device = Played(RATE_HZ, (FULL_SCALE_WORD,) * ACTUATORS, 200, clicks.basis)
    device.send(clicks.play(0, reference(device.now_us)))
    device.wait(9_000)
    device.send(greeting())
    device.send(BasisBegin(1, 400))
    device.send(BasisChunk(0, b"\x55" * BASIS_CHUNK_SIZE))
    device.wait(20_000)
    samples = device.take() / FULL_OUTPUT
    assert np.abs(samples).max() > 0.5
    assert np.abs(np.diff(samples, axis=0)).max() <= 200 / RATE_HZ + 100 * ROUNDING
    assert not samples[9_000 * RATE_HZ // US_PER_S + RATE_HZ // 200 + 2 :].any()


def test_a_click_that_plays_on_while_a_second_basis_takes_its_memory_fades() -> None:
    """Nothing else ends it: a displacement that stands still would stay for ever."""
    rise = np.minimum(np.minimum(np.arange(4_000), np.arange(4_000)[::-1]) / 100, 1.0)
    clicks = Clicks(RATE_HZ, [np.outer(rise, [1.0, -1.0])])
    device = Played(RATE_HZ, (FULL_SCALE_WORD,) * ACTUATORS, 200, clicks.basis)
    device.send(clicks.play(0, reference(device.now_us)))
    device.wait(20_000)
    for message in transfer_messages(Clicks(RATE_HZ, [np.outer(rise[::-1] / 2, [1.0, 0.0])]).basis.data):
        device.send(message)
    device.wait(20_000)
    for message in list(transfer_messages(b"\x55" * len(clicks.basis.data)))[:-1]:  # the last would check them
        device.send(message)
    device.wait(100_000)
    samples = np.abs(device.take()).max(axis=1) / FULL_OUTPUT
    released = 40_000 * RATE_HZ // US_PER_S
    assert samples[released - 10 : released].min() > 0.99
    assert np.abs(np.diff(samples[released:])).max() <= 200 / RATE_HZ + 2 * ROUNDING
    assert not samples[released + RATE_HZ // 200 + 2 :].any()
