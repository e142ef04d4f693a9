"""Laws of shaped bursts: what firmware without waveforms plays, within its limits, better than the drive just gated."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from engine.touch import ZoneState
from firmware_link.emulator.firmware import DeviceConfiguration, EmulatedFirmware
from firmware_link.emulator.synthesis import synthesise
from firmware_link.protocol.messages import (
    FULL_SCALE_WORD,
    MAGIC,
    SHAPE_FULL_GAIN,
    Arm,
    ChannelDrive,
    HelloRequest,
    Set,
    SetFlag,
    encode_drive,
)
from firmware_link.protocol.onset import OnsetStep, make_shape
from precompute.clicks import onset_design
from precompute.clicks.baselines import gated_drive
from precompute.clicks.basis import PLAY_RATE_HZ
from precompute.clicks.onset_design import ShapedOnset, choose_steps, fit_each, fit_steps, solve_burst, solve_onset
from precompute.clicks.solver import ClickSolver
from precompute.entries.prediction import touched_zones
from precompute.entries.solver import EntrySolver
from precompute.model.assembly import assemble
from tests.firmware_link.strategies import RESOLUTION_HZ
from tests.firmware_link.virtual_rig import BOOT_ID, BareHost, reference
from tests.precompute.clicks.click_cases import CHEAP, states
from tests.precompute.devices import shipped

Array = NDArray[np.float64]
LETTERS = ("F--q-", "q--F-")
LONGEST_S = max(CHEAP.lengths_s)
any_burst = pytest.mark.parametrize("kind", ["onset", "burst"])
any_letters = pytest.mark.parametrize("letters", LETTERS)


@pytest.fixture(scope="module")
def solver() -> ClickSolver:
    device = shipped("reference-a")
    return ClickSolver(replace(device, sweep=replace(device.sweep, step_hz=4.0)), CHEAP)


@pytest.fixture(scope="module")
def bursts(solver: ClickSolver) -> dict[tuple[str, str], ShapedOnset]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(onset_design, "_GENERATIONS", 8)  # laws, not figures
        entries = EntrySolver(assemble(solver.device))
        return {
            (kind, letters): solve_onset(solver, entries.solve(states(letters))[0])
            if kind == "onset"
            else solve_burst(solver, states(letters))
            for letters in LETTERS
            for kind in ("onset", "burst")
        }


@any_burst
@any_letters
def test_it_is_within_the_limits_and_over_in_time(
    solver: ClickSolver, bursts: dict[tuple[str, str], ShapedOnset], kind: str, letters: str
) -> None:
    burst = bursts[kind, letters]
    assert abs(burst.waveform).max() <= solver.device.limits.amplitude + 1e-12
    assert not burst.waveform[:, 0].any() and not burst.waveform[:, -1].any()
    assert burst.waveform.shape == (2, round(LONGEST_S * PLAY_RATE_HZ) + 1)
    ends_s = [step.until_s for step in burst.steps]
    assert ends_s == sorted(ends_s) and ends_s[-1] <= burst.stop_s + 1e-4 < LONGEST_S
    for hz, actuator in zip(burst.tone.frequencies_hz, solver.device.actuators, strict=True):
        assert actuator.band_hz[0] <= hz <= actuator.band_hz[1]


@any_burst
@any_letters
def test_firmware_that_is_told_its_steps_plays_its_waveform(
    solver: ClickSolver, bursts: dict[tuple[str, str], ShapedOnset], kind: str, letters: str
) -> None:
    """HELLO, SHAPE, ARM, SET and a SET of silence, as bytes, to the emulated firmware; what it synthesises."""
    burst, slew = bursts[kind, letters], round(solver.device.limits.slew_per_s)
    host = BareHost(EmulatedFirmware(DeviceConfiguration(BOOT_ID)))
    for message in (
        HelloRequest(MAGIC, 1, 0, 1),
        make_shape(0, burst.steps),
        Arm(BOOT_ID, slew, 100, 0, (FULL_SCALE_WORD,) * 2),
    ):
        host.send(message, 0)
    tone = burst.tone
    drive = [ChannelDrive(*each) for each in zip(tone.frequencies_hz, tone.amplitudes, tone.phases_rad, strict=True)]
    stop_us = round(burst.stop_s * 1e6)
    for channels, now_us in ((drive, 0), ([replace(each, amplitude=0.0) for each in drive], stop_us)):
        host.send(Set(reference(now_us), SetFlag.WRITE_PHASE, 100, 1, encode_drive(channels, RESOLUTION_HZ)), now_us)
    host.firmware.advance(round(LONGEST_S * 1e6))
    played = synthesise(host.firmware.drive_log, 0, LONGEST_S * 1e6, PLAY_RATE_HZ).T
    assert played == pytest.approx(burst.waveform[:, : played.shape[1]], abs=0.01 * abs(burst.waveform).max())


@any_letters
def test_quiet_fingers_keep_to_their_level_in_the_plants_it_was_trimmed_on(
    solver: ClickSolver, bursts: dict[tuple[str, str], ShapedOnset], letters: str
) -> None:
    burst = bursts["onset", letters]
    quiet = letters.replace("-", "").index("q")
    peak = solver.plants_of(touched_zones(states(letters))).trimmed.peaks(burst.waveform, [quiet])[1:]
    assert 20 * np.log10(np.percentile(peak, 95)) <= CHEAP.quiet_db + 0.1


@any_letters
def test_it_is_felt_more_than_the_drive_gated_and_less_than_a_waveform(
    solver: ClickSolver, bursts: dict[tuple[str, str], ShapedOnset], letters: str
) -> None:
    state = states(letters)
    gated = solver.judge(state, LONGEST_S, gated_drive(solver, state, LONGEST_S), "gated")
    felt_db = [bursts[kind, letters].verdict.felt.low_db for kind in ("onset", "burst")]
    assert gated.verdict.felt.low_db < max(felt_db) < solver.solve(state).verdict.felt.low_db


def test_steps_that_are_shared_are_few_and_cost_no_more_than_they_must(
    solver: ClickSolver, bursts: dict[tuple[str, str], ShapedOnset]
) -> None:
    own = list(bursts.values())
    fitted = [fit_each(solver, burst, [other.steps for other in own]) for burst in own]
    shared = {count: choose_steps(fitted, count) for count in (1, 2, 4)}
    total_db = {count: sum(each.verdict.felt.low_db for each in found) for count, found in shared.items()}
    for count, found in shared.items():
        assert len({each.steps for each in found}) <= count
        assert [each.states for each in found] == [each.states for each in own]
    assert total_db[1] <= total_db[2] <= total_db[4]


def test_no_steps_are_a_plain_burst(solver: ClickSolver, bursts: dict[tuple[str, str], ShapedOnset]) -> None:
    plain = fit_steps(solver, bursts["onset", "F--q-"], [OnsetStep(0.0, 1.0)])
    inside = slice(round(0.006 * PLAY_RATE_HZ), round((plain.stop_s - 0.001) * PLAY_RATE_HZ))
    time_s = np.arange(plain.waveform.shape[1])[inside] / PLAY_RATE_HZ
    for row, hz, amplitude, phase in zip(
        plain.waveform, plain.tone.frequencies_hz, plain.tone.amplitudes, plain.tone.phases_rad, strict=True
    ):
        assert row[inside] == pytest.approx(amplitude * np.sin(2 * np.pi * hz * time_s + phase), abs=1e-9)
    assert all(round(step.gain * SHAPE_FULL_GAIN) == SHAPE_FULL_GAIN for step in plain.steps)
    assert plain.states.count(ZoneState.FELT) == 1
