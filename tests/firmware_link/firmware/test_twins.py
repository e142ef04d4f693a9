"""The C core and the Python one do the same: every byte they send, every state, every sample within rounding."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from random import Random

import pytest
from hypothesis import settings

from firmware_link.protocol.drive_words import ChannelDrive, encode_drive
from firmware_link.protocol.messages import FULL_SCALE_WORD, Arm, DeviceState, Set, SetFlag
from tests.firmware_link.firmware.compiled_core import FULL_OUTPUT
from tests.firmware_link.firmware.twins import (
    ACTUATORS,
    CONFIGURATION,
    HURRIED_STEPS,
    RAMP_US,
    SAMPLE_US,
    SLEW_PER_S,
    Session,
    Twins,
    run_sessions,
)
from tests.firmware_link.law_host import greeting
from tests.firmware_link.strategies import RESOLUTION_HZ
from tests.firmware_link.virtual_rig import BOOT_ID, reference


@contextmanager
def compared() -> Iterator[Twins]:
    """Both, ready; all that sounded is compared in the end."""
    with Twins() as twins:
        twins.make_ready()
        yield twins
        twins.wait(100_000)
        twins.compare_samples()


def sound(twins: Twins, frequency_hz: float, phase_rad: float, *amplitudes: float) -> None:
    drive = encode_drive([ChannelDrive(frequency_hz, each, phase_rad) for each in amplitudes], RESOLUTION_HZ)
    twins.drive(Set(reference(twins.now_us), SetFlag.WRITE_PHASE, 40, drive))


def test_random_sessions_are_the_same_to_both() -> None:
    counts = run_sessions(seed=1, first=0, frames=100 * settings().max_examples)
    # The sessions are such that every command is taken, is late and is refused, and transfers end both ways.
    assert all(counts[f"{kind} accepted"] for kind in ("ACK", "HELLO_REQ", "SENSE", "STOP", "TIME_REQ"))
    for kind in ("SET", "PLAY", "KEEPALIVE"):
        assert all(counts[f"{kind} {outcome}"] for outcome in ("accepted", "stale", "refused"))
    for kind in ("ARM", "BASIS_BEGIN", "BASIS_CHUNK", "BASIS_COMMIT"):
        assert all(counts[f"{kind} {outcome}"] for outcome in ("accepted", "refused"))


@pytest.mark.parametrize("seed", range(3))
def test_both_sound_the_same_through_crossfades_that_are_overtaken(seed: int) -> None:
    for number in range(settings().max_examples):
        with Session(Random(f"{seed} {number}")) as session:
            session.make_ready()
            session.run(HURRIED_STEPS, 30)


@pytest.mark.parametrize("wait_us", [0, 1, SAMPLE_US - 1])
def test_what_comes_between_two_samples_begins_at_the_second(wait_us: int) -> None:
    with compared() as twins:
        for pause_us, phase_rad in ((wait_us, 0.0), (2_000, 1.0), (0, 3.0)):
            twins.wait(pause_us)
            sound(twins, 655.35, phase_rad, 1.0, 1.0)


def test_an_onset_that_waits_for_the_rest_of_a_fall_comes_a_sample_late_at_most() -> None:
    with compared() as twins:
        # Silence cuts a crossfade short, for 61.04 samples; what is left of it then is to fall anew.
        cut_short = ((0.30518, 0.0, 20_000), (0.30518, 1.0, 400), (0.0, 0.0, 1_525))
        for amplitude, phase_rad, pause_us in (*cut_short, (1.0, 0.0, 0), (0.0, 0.0, 0), (1.0, 1.6, 0)):
            sound(twins, 60.0, phase_rad, amplitude, amplitude)
            twins.wait(pause_us)


@pytest.mark.parametrize("order", [1, -1])
def test_an_onset_that_waits_for_unequal_falls_begins_where_the_longer_one_ends(order: int) -> None:
    """Not at the next sample: that would be off by up to a step of the slew, 160 steps of the output."""
    with compared() as twins:
        falls = ((0.7, 0.3, 20_000), (0.9, 0.2, 1_000), (0.0, 0.0, 0))
        for phase_rad, (*amplitudes, pause_us) in enumerate((*falls, (1.0, 1.0, 30_000))):
            sound(twins, 60.0, phase_rad, *amplitudes[::order])
            twins.wait(pause_us)
        twins.compare_samples(2 / FULL_OUTPUT)


@pytest.mark.parametrize(("words", "fallen_us"), [(2, SAMPLE_US), (4, 2 * SAMPLE_US)])
def test_less_than_half_of_the_least_amplitude_is_silence_to_both(words: int, fallen_us: int) -> None:
    """At the lowest slew 1.64 words fall in a sample: what has 0.72 left goes on in phase, what has 0.36 does not."""
    with Twins() as twins:
        twins.send(greeting())
        twins.send(Arm(BOOT_ID, 1, 40, 0, (FULL_SCALE_WORD,) * ACTUATORS))
        before = ((words / FULL_SCALE_WORD, 1_000), (0.0, fallen_us))
        for phase_rad, (amplitude, pause_us) in enumerate((*before, (1.0, 30_000))):
            sound(twins, 60.0, phase_rad, amplitude, amplitude)
            twins.wait(pause_us)
        twins.compare_samples(2 / FULL_OUTPUT)


@pytest.mark.parametrize("wait_us", range(0, 20_000, 500))
def test_both_have_room_for_a_click_again_at_the_same_instant(wait_us: int) -> None:
    with compared() as twins:
        for pause_us in (2_000, wait_us, 0):
            twins.drive(twins.click(0))
            twins.wait(pause_us)
        assert twins.python.counters.refused == (wait_us < RAMP_US)


@pytest.mark.parametrize("amplitudes", [(0, 0, 0), (FULL_SCALE_WORD, FULL_SCALE_WORD)], ids=["silent", "faded"])
def test_clicks_that_are_over_leave_room_for_those_that_start_at_the_same_sample(amplitudes: tuple[int, ...]) -> None:
    with compared() as twins:
        for amplitude in amplitudes:
            twins.drive(replace(twins.click(0), amplitude=amplitude))
        twins.fall_silent()
        twins.wait(RAMP_US if amplitudes[0] else 0)
        for _ in range(2):
            twins.drive(twins.click(0))


def test_new_limits_bound_what_still_fades_though_the_drive_is_the_same() -> None:
    with compared() as twins:
        twins.drive(twins.click(0))
        twins.wait(20_000)
        twins.fall_silent()
        twins.send(Arm(BOOT_ID, SLEW_PER_S, 40, 0, (FULL_SCALE_WORD // 8,) * ACTUATORS))
        twins.fall_silent()


@pytest.mark.parametrize(("armed_s", "own_s", "wanted_s"), [(2, 1, 1), (1, 2, 1), (0, 1, 1), (1, 0, 1), (0, 0, None)])
def test_the_shorter_of_two_on_time_limits_holds(armed_s: int, own_s: int, wanted_s: int | None) -> None:
    with Twins(replace(CONFIGURATION, longest_drive_s=own_s)) as twins:
        twins.send(greeting())
        twins.send(Arm(BOOT_ID, SLEW_PER_S, 40, armed_s, (FULL_SCALE_WORD,) * ACTUATORS))
        drive = encode_drive([ChannelDrive(60.0, 1.0)] * ACTUATORS, RESOLUTION_HZ)
        driven_ms = 0
        while twins.python.state is not DeviceState.LATCHED and driven_ms < 2_500:
            twins.drive(Set(reference(twins.now_us), SetFlag.WRITE_PHASE, 40, drive))
            twins.wait(20_000)
            driven_ms += 20
        assert driven_ms == (2_500 if wanted_s is None else 1_000 * wanted_s)
