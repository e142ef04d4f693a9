"""Laws of the synthesis: no steps, the slew is kept, coherent channels stay coherent, chunks join."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_link.emulator.drive_log import Cause, ChannelTarget, DriveEvent, PlayedWaveform
from firmware_link.emulator.synthesis import Synthesis, synthesise
from tests.firmware_link.law_host import US_PER_S
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
def test_the_amplitudes_of_a_channel_together_keep_the_slew_and_pass_no_target(log: list[DriveEvent]) -> None:
    # At 0 Hz and a quarter turn of every phase the displacement is the amplitude itself.
    still = [replace(item, channels=tuple(_still(target) for target in item.channels)) for item in log]
    amplitude = synthesise([event(0, *(ChannelTarget(0.0, 0.0, math.pi / 2),) * 2), *still], 0, STOP_US, RATE_HZ)
    assert np.abs(np.diff(amplitude, axis=0)).max() <= log[0].slew_per_s / RATE_HZ + 1e-9
    assert amplitude.min() >= -1e-12
    targets = np.array([[channel.amplitude for channel in item.channels] for item in log])
    assert (amplitude.max(axis=0) <= targets.max(axis=0) + 1e-9).all()


QUIET = ChannelTarget(100.0, 0.0, None)


def _still(target: ChannelTarget) -> ChannelTarget:
    return replace(target, frequency_hz=0.0, phase_rad=None if target.phase_rad is None else math.pi / 2)


@unhurried
@given(drive_logs(2), st.floats(50, 600), st.floats(0, math.tau), st.floats(0, math.tau), st.integers(0, 20_000))
def test_channels_written_together_are_coherent_whatever_sounded(
    log: list[DriveEvent], frequency_hz: float, first_rad: float, second_rad: float, wait_us: int
) -> None:
    last = log[-1]
    written_us = last.device_time_us + wait_us
    both = (ChannelTarget(frequency_hz, 0.8, first_rad), ChannelTarget(frequency_hz, 0.4, second_rad))
    log = [*log, event(written_us, *both, slew_per_s=last.slew_per_s)]
    # What waits for a crossfade begins within that, and is a crossfade itself.
    settled_us = written_us + 4 * US_PER_S / last.slew_per_s
    got = synthesise(log, settled_us, settled_us + 10_000, RATE_HZ)
    first_sample = math.ceil(settled_us * RATE_HZ / US_PER_S)
    turns = math.tau * frequency_hz * np.arange(first_sample, first_sample + len(got)) / RATE_HZ
    fitted = np.linalg.lstsq(np.column_stack([np.sin(turns), np.cos(turns)]), got, rcond=None)[0]
    first, second = fitted[0] + 1j * fitted[1]
    assert abs(first) == pytest.approx(0.8, abs=1e-8)
    assert second / first == pytest.approx(0.5 * np.exp(1j * (second_rad - first_rad)), abs=1e-7)


@unhurried
@given(drive_logs(2), st.integers(0, 20_000))
def test_silence_comes_within_the_ramp_whatever_sounds(log: list[DriveEvent], wait_us: int) -> None:
    last = log[-1]
    stop_us = last.device_time_us + wait_us
    log = [*log, event(stop_us, QUIET, QUIET, slew_per_s=last.slew_per_s)]
    silent_us = stop_us + US_PER_S / last.slew_per_s
    assert np.abs(synthesise(log, silent_us, silent_us + 50_000, RATE_HZ)).max() < 1e-12


@unhurried
@given(drive_logs(2), st.integers(0, 70_000))
def test_what_is_forgotten_changes_nothing_that_comes(log: list[DriveEvent], before_us: int) -> None:
    shortened = Synthesis()
    for item in log:
        shortened.take_events([item])
        shortened.forget(min(item.device_time_us, before_us))
    shortened.forget(before_us)
    got = shortened.displacements(before_us, STOP_US, RATE_HZ)
    np.testing.assert_array_equal(got, synthesise(log, before_us, STOP_US, RATE_HZ))
    with pytest.raises(ValueError, match="is forgotten"):
        shortened.displacements(before_us - 1, STOP_US, RATE_HZ)


@unhurried
@given(
    st.floats(60, 600),
    st.tuples(*[st.floats(0.05, 1.0)] * 4),
    st.tuples(*[st.floats(-0.3, 0.3)] * 2),
    st.floats(0, math.tau),
    st.integers(0, 30_000),
)
def test_drives_that_differ_a_little_differ_a_little_while_one_becomes_the_other(
    frequency_hz: float, amplitudes: tuple[float, ...], changes_rad: tuple[float, ...], turned_rad: float, wait_us: int
) -> None:
    """While w goes from 0 to 1 the displacement is (1 - w) of the old and w of the new drive, as far as both differ."""
    old = [ChannelTarget(frequency_hz, amplitude, 0.0) for amplitude in amplitudes[:2]]
    new = [
        ChannelTarget(frequency_hz, amplitude, (turned_rad + change_rad) % math.tau)
        for amplitude, change_rad in zip(amplitudes[2:], changes_rad, strict=True)
    ]
    log, changed_us = [event(0, *old), event(40_000 + wait_us, *new)], 40_000 + wait_us
    length_us = max(before + after for before, after in zip(amplitudes[:2], amplitudes[2:], strict=True)) * 5_000
    got = synthesise(log, changed_us, changed_us + 20_000, RATE_HZ)
    went_on = synthesise(log[:1], changed_us, changed_us + 20_000, RATE_HZ)
    first_sample = math.ceil(changed_us * RATE_HZ / US_PER_S)
    times_s = np.arange(first_sample, first_sample + len(got)) / RATE_HZ
    w = np.clip((1e6 * times_s - changed_us) / length_us, 0.0, 1.0)[:, None]
    # The loudest of the new channels goes on in phase, and the other keeps its angle to it.
    loudest = int(amplitudes[3] > amplitudes[2])
    angles = math.tau * frequency_hz * times_s[:, None] + np.array(changes_rad) - changes_rad[loudest]
    np.testing.assert_allclose(got, (1 - w) * went_on + w * np.array(amplitudes[2:]) * np.sin(angles), atol=1e-8)


def test_what_is_over_is_forgotten() -> None:
    synthesis, loud = Synthesis(), replace(QUIET, amplitude=0.5)
    samples = np.zeros((101, 2), np.int16)
    for start_us in (0, 20_000, 40_000):
        played = PlayedWaveform.of(10_000, samples, 1.0)  # 10 ms long
        synthesis.take_events(
            [replace(event(start_us, QUIET, QUIET), waveform=played), event(start_us + 15_000, loud, loud)]
        )
    synthesis.forget(54_999)
    assert len(synthesis._events) == 2
    synthesis.forget(55_000)
    # The last event, and the stretch of each channel that it began.
    assert (len(synthesis._events), synthesis.size) == (1, 3)
    # A click that a later event took over fades on.
    played = PlayedWaveform.of(10_000, samples, 1.0)
    synthesis.take_events([replace(event(60_000, QUIET, QUIET), waveform=played), event(65_000, loud, loud)])
    for before_us, kept in ((69_999, 2), (70_000, 1)):
        synthesis.forget(before_us)
        assert len(synthesis._events) == kept
