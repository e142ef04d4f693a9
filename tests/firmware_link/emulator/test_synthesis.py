"""Laws of the synthesis: no steps, the slew is kept, coherent channels stay coherent, chunks join."""

import itertools
import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from firmware_link.emulator import Cause, ChannelTarget, DriveEvent, PlayedWaveform, synthesise
from firmware_link.protocol.basis import SAMPLE_FULL_SCALE
from tests.firmware_link.strategies import drive_logs, unhurried

RATE_HZ = 100_000.0
STOP_US = 90_000


def event(time_us: int, *targets: ChannelTarget, slew_per_s: float = 200.0) -> DriveEvent:
    return DriveEvent(time_us, Cause.SET, 0, slew_per_s, targets)


@unhurried
@given(drive_logs(2), st.lists(st.integers(0, STOP_US), max_size=6))
def test_any_chunking_gives_the_same(log: list[DriveEvent], cuts: list[int]) -> None:
    edges = [0, *sorted(cuts), STOP_US]
    chunks = [synthesise(log, start, stop, 44_100.0) for start, stop in itertools.pairwise(edges)]
    np.testing.assert_allclose(np.concatenate(chunks), synthesise(log, 0, STOP_US, 44_100.0), rtol=0, atol=1e-9)


@unhurried
@given(drive_logs(2))
def test_no_step_and_never_beyond_the_targets(log: list[DriveEvent]) -> None:
    displacements = synthesise(log, 0, STOP_US, RATE_HZ)
    for actuator in range(2):
        targets = [item.channels[actuator] for item in log]
        greatest = max(target.amplitude for target in targets)
        fastest_per_s = math.tau * 600 * greatest + log[0].slew_per_s
        assert np.abs(displacements[:, actuator]).max() <= greatest + 1e-9
        assert np.abs(np.diff(displacements[:, actuator])).max() <= fastest_per_s / RATE_HZ + 1e-9


@unhurried
@given(drive_logs(1))
def test_amplitude_keeps_the_slew(log: list[DriveEvent]) -> None:
    # At 0 Hz and a quarter turn the displacement is the amplitude itself.
    still = [
        event(item.device_time_us, ChannelTarget(0.0, target.amplitude, _quarter(target)), slew_per_s=item.slew_per_s)
        for item in log
        for target in item.channels
    ]
    first = event(0, ChannelTarget(0.0, 0.0, math.pi / 2))
    amplitude = synthesise([first, *still], 0, STOP_US, RATE_HZ)[:, 0]
    assert np.abs(np.diff(amplitude)).max() <= log[0].slew_per_s / RATE_HZ + 1e-9
    assert amplitude.min() >= -1e-12


def _quarter(target: ChannelTarget) -> float | None:
    return None if target.phase_rad is None else math.pi / 2


@unhurried
@given(st.floats(1, 600), st.floats(0, math.tau), st.floats(0, math.tau), st.integers(0, 9_000))
def test_channels_written_together_are_coherent_whatever_sounded(
    frequency_hz: float, first_rad: float, second_rad: float, written_us: int
) -> None:
    log = [
        event(0, ChannelTarget(77.0, 1.0, 0.3), ChannelTarget(133.0, 0.2, None)),
        event(written_us, ChannelTarget(frequency_hz, 0.8, first_rad), ChannelTarget(frequency_hz, 0.4, second_rad)),
    ]
    settled_us = written_us + 20_000
    got = synthesise(log, settled_us, settled_us + 10_000, RATE_HZ)
    first_sample = math.ceil(settled_us * RATE_HZ / 1e6)
    time_s = np.arange(first_sample, first_sample + len(got)) / RATE_HZ - written_us * 1e-6
    turns = math.tau * frequency_hz * time_s
    wanted = np.column_stack([0.8 * np.sin(turns + first_rad), 0.4 * np.sin(turns + second_rad)])
    np.testing.assert_allclose(got, wanted, rtol=0, atol=1e-8)


def test_a_frequency_change_keeps_the_phase() -> None:
    log = [event(0, ChannelTarget(50.0, 1.0, 0.0)), event(30_000, ChannelTarget(400.0, 1.0, None))]
    before_us = np.arange(2_000, 3_000) * 10.0
    got = synthesise(log, 20_000, 40_000, RATE_HZ)[:, 0]
    after_s = np.arange(1_000) / RATE_HZ
    np.testing.assert_allclose(got[:1000], np.sin(math.tau * 50e-6 * before_us), atol=1e-9)
    np.testing.assert_allclose(got[1000:], np.sin(math.tau * (50 * 0.03 + 400 * after_s)), atol=1e-9)


def test_a_phase_write_fades_out_then_in() -> None:
    log = [event(0, ChannelTarget(0.0, 1.0, math.pi / 2)), event(20_000, ChannelTarget(0.0, 0.5, -math.pi / 2))]
    got = synthesise(log, 0, 40_000, 1000.0)[:, 0]
    np.testing.assert_allclose(got[[5, 19, 20, 21, 25, 26, 27, 28]], [1, 1, 1, 0.8, 0, -0.2, -0.4, -0.5], atol=1e-12)


def test_nothing_before_the_first_event_and_no_actuators_in_an_empty_log() -> None:
    log = [event(10_000, ChannelTarget(100.0, 1.0, 0.0))]
    assert not synthesise(log, -5_000, 10_000, 8000.0).any()
    assert synthesise([], 0, 1000, 8000.0).shape == (8, 0)


# ---- waveforms ---------------------------------------------------------------------------------------------

WAVEFORM = np.array([[0.0, 0.0], [1.0, -0.5], [-1.0, 0.5], [0.0, 0.0]])
SILENT = (ChannelTarget(100.0, 0.0, None),) * 2


def waveform(rate_hz: int, samples: NDArray[np.float64], amplitude: float) -> PlayedWaveform:
    return PlayedWaveform.of(rate_hz, np.rint(SAMPLE_FULL_SCALE * samples).astype(np.int16), amplitude)


def play(time_us: int, amplitude: float, *targets: ChannelTarget) -> DriveEvent:
    return DriveEvent(time_us, Cause.PLAY, 0, 200.0, targets or SILENT, waveform(1000, WAVEFORM, amplitude))


def test_a_waveform_is_straight_between_its_samples_and_zero_after() -> None:
    got = synthesise([play(2_000, 0.5)], 0, 8_000, 4_000.0)
    wanted = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0.125, 0.25, 0.375, 0.5, 0.25, 0, -0.25, -0.5, -0.375, -0.25, -0.125, 0]
    np.testing.assert_allclose(got[: len(wanted), 0], wanted, atol=1e-4)
    np.testing.assert_allclose(got[:, 1], -0.5 * got[:, 0], atol=1e-4)
    assert not got[len(wanted) :].any()


def test_what_is_taken_over_fades_at_the_slew_while_it_plays_on() -> None:
    long = np.array([[0.0], [1.0], [1.0], [1.0], [0.0]])
    log = [
        DriveEvent(0, Cause.PLAY, 0, 200.0, SILENT[:1], waveform(100, long, 1.0)),
        DriveEvent(20_000, Cause.STOP, None, 200.0, SILENT[:1]),
    ]
    got = synthesise(log, 0, 40_000, 1000.0)[:, 0]
    np.testing.assert_allclose(got[[10, 19, 20, 21, 23, 25, 26]], [1, 1, 1, 0.8, 0.4, 0, 0], atol=1e-12)


def test_the_sum_is_clamped_to_the_limit() -> None:
    sounding = ChannelTarget(0.0, 0.4, math.pi / 2, limit=0.6)
    faded = ChannelTarget(0.0, 0.0, None, limit=0.6)
    log = [event(0, sounding, sounding), play(10_000, 1.0, faded, faded)]
    got = synthesise(log, 10_000, 13_000, 10_000.0)
    assert got[:, 0].max() == 0.6
    assert np.abs(got).max() == 0.6
