"""Laws of transfer functions, one plant in frequency, in time and in clicks, and of the threshold as a filter."""

from dataclasses import replace

import numpy as np
import pytest

from engine.device import Device, Threshold
from engine.device.named_files import shipped_names
from engine.device.threshold import DEFAULT, shipped_threshold
from precompute.clicks.click_basis import lines_for
from precompute.clicks.click_plants import SampledPlants
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.model.response import blocked_force, solve_response
from precompute.model.transfers import DelayFilter, TransferFilter, moved_bases, threshold_filter
from precompute.model.transient import TransientPlant
from precompute.predict.rise_time import compute_rise_model, compute_rise_time
from precompute.sampling.plants import sample_scenarios
from tests.engine.device.test_actuator_transfer import coupled, lag, points_of
from tests.precompute.devices import shipped

BARE = shipped("reference-a")
PLACES_M = np.array([0.05, 0.14, 0.23])
RATE_HZ = 48_000.0


def with_transfers(device: Device = BARE) -> Device:
    left, right = device.actuators
    actuators = (replace(left, transfer=points_of(lag)), replace(right, transfer=points_of(coupled)))
    return replace(device, actuators=actuators)


DEVICE = with_transfers()
LATE_S = 133e-6  # 6.4 samples at 48 kHz
LATE = replace(DEVICE, actuators=(DEVICE.actuators[0], replace(DEVICE.actuators[1], delay_s=LATE_S)))


def test_responses_are_those_of_the_bar_times_the_transfer_functions() -> None:
    hz = np.array([60.0, 121.3, 250.0, 300.0])
    bare, found = (solve_response(assemble(d), hz, PLACES_M).acceleration(PLACES_M) for d in (BARE, DEVICE))
    expected = bare.copy()
    expected[:, 0] *= lag(2j * np.pi * hz)[:, None]
    expected[:, 1] *= coupled(2j * np.pi * hz)[:, None]
    assert found[:, :2] == pytest.approx(expected[:, :2], rel=2e-3)
    assert found[:, 2:] == pytest.approx(bare[:, 2:], rel=1e-12)  # forces at places go through no driver


def test_a_delay_turns_the_response_and_a_click_by_its_phase() -> None:
    hz = np.array([60.0, 121.3, 300.0])
    found, early = (solve_response(assemble(d), hz, PLACES_M).acceleration(PLACES_M) for d in (LATE, DEVICE))
    turned = early.copy()
    turned[:, 1] *= np.exp(-2j * np.pi * hz * LATE_S)[:, None]
    assert found == pytest.approx(turned, rel=1e-12)
    assert blocked_force(LATE.actuators, hz) / blocked_force(DEVICE.actuators, hz) == pytest.approx(
        np.stack([np.ones(3), np.exp(-2j * np.pi * hz * LATE_S)], axis=1), rel=1e-12
    )
    lines = lines_for(DEVICE, 0.03)
    late, soon = (SampledPlants(sample_scenarios(d, 2, seed=1), lines, modes=24) for d in (LATE, DEVICE))
    fingers = late.scenarios.place(PLACES_M.tolist())
    ratio = late.transfer(fingers) / soon.transfer(fingers)
    assert ratio[:, :, 0] == pytest.approx(1.0, rel=1e-5)
    assert abs(ratio[:, :, 1] / np.exp(-lines.s_per_s * LATE_S) - 1).max() < 1e-5


def test_a_delay_in_time_is_the_course_later_whatever_stretches_it_comes_in() -> None:
    time_s, hz = np.arange(4800) / RATE_HZ, 211.0
    course = np.sin(2 * np.pi * hz * time_s)
    late = DelayFilter(LATE_S, RATE_HZ)
    found = np.concatenate([late.run(part) for part in np.split(course, [1, 4, 3000])])
    assert not found[: int(LATE_S * RATE_HZ)].any()
    assert found[8:] == pytest.approx(np.sin(2 * np.pi * hz * (time_s[8:] - LATE_S)), abs=1e-4)
    assert DelayFilter(2 / RATE_HZ, RATE_HZ).run(np.array([1.0, 2.0, 3.0, 4.0])).tolist() == [0, 0, 1, 2]


@pytest.mark.parametrize("device", [DEVICE, LATE], ids=["transfers", "a delay too"])
def test_the_bar_in_time_settles_to_the_response_in_frequency(device: Device) -> None:
    hz, plant = 173.0, assemble(device)
    moving = TransientPlant(compute_basis(plant), PLACES_M, RATE_HZ)
    fingers = [(float(at), DEVICE.finger) for at in PLACES_M]
    moving.touch(fingers)
    time_s = np.arange(round(0.6 * RATE_HZ)) / RATE_HZ
    command = np.stack([0.7 * np.cos(2 * np.pi * hz * time_s), np.sin(2 * np.pi * hz * time_s)], axis=1)
    # In stretches of unequal length, two of them empty, between which the filters go on.
    parts = [moving.accelerate(part) for part in np.split(command, [0, 1, 5000, 5000, 5001])]
    late = np.concatenate(parts)[-round(0.1 * RATE_HZ) :]
    turns = np.exp(-2j * np.pi * hz * time_s[-len(late) :])
    window = np.hanning(len(late))[:, None]
    found = 2 * (late * window * turns[:, None]).sum(axis=0) / window.sum()
    loaded = plant.with_fingers(PLACES_M.tolist(), DEVICE.finger)
    unit = solve_response(loaded, np.array([hz])).acceleration(PLACES_M)[0]
    assert found == pytest.approx(np.array([0.7, -1j]) @ unit, rel=2e-3)


def test_clicks_see_the_plant_that_moves_in_time() -> None:
    lines = lines_for(DEVICE, 0.03)
    with_them, without = (SampledPlants(sample_scenarios(d, 2, seed=1), lines, modes=24) for d in (DEVICE, BARE))
    fingers = with_them.scenarios.place(PLACES_M.tolist())
    ratio = with_them.transfer(fingers) / without.transfer(fingers)
    course = np.zeros((lines.size, 2))
    course[0] = 1.0
    for index, actuator in enumerate(DEVICE.actuators):
        assert actuator.transfer is not None
        # The courses of both, filtered in time at ten times the rate, then transformed on the damped lines.
        fine = np.repeat(course[:, index], 10)
        filtered = TransferFilter(actuator.transfer, 10 * lines.rate_hz).run(fine).reshape(-1, 10).mean(axis=1)
        expected = lines.transform(filtered) / lines.transform(course[:, index])
        low = lines.s_per_s.imag < 2 * np.pi * 300  # holding a sample is as good as this below 300 Hz
        assert abs(ratio[:, :, index, low] / expected[low] - 1).max() < 0.03
        assert ratio[0, 0, index] == pytest.approx(actuator.transfer.series.at(lines.s_per_s), rel=1e-4)


def test_rise_times_are_of_the_bases_as_they_move() -> None:
    basis, fingers = compute_basis(assemble(BARE)), [(0.05, BARE.finger)]
    hz, amplitude = np.array([150.0, 150.0]), np.array([1.0, -0.4 + 0.2j])
    models = [
        compute_rise_model(replace(basis, plant=assemble(device)), fingers, PLACES_M[:1]) for device in (BARE, DEVICE)
    ]
    undone = amplitude / moved_bases(DEVICE.actuators, hz, np.ones(2, dtype=np.complex128))
    assert compute_rise_time(models[1], hz, undone) == pytest.approx(compute_rise_time(models[0], hz, amplitude))
    assert compute_rise_time(models[1], hz, amplitude) != pytest.approx(compute_rise_time(models[0], hz, amplitude))


rates = pytest.mark.parametrize("rate_hz", [4000.0, 8000.0, 48000.0])
TOLERANCE_DB = {DEFAULT: 0.03, "android": 0.2}
"""A curve with corners close to each other needs a longer filter than 0.1 s."""
NAMES = shipped_names("threshold")
curves = pytest.mark.parametrize("curve", list(map(shipped_threshold, NAMES)), ids=NAMES)


@rates
@curves
def test_a_steady_tone_at_its_threshold_comes_out_as_one_with_the_least_delay(curve: Threshold, rate_hz: float) -> None:
    """No zero outside the unit circle (Jensen): the mean of ln|H| over all frequencies is then ln|h_0|."""
    taps, tone_hz = threshold_filter(curve, rate_hz), np.geomspace(30.0, 1000.0, 60)
    gain = np.exp(-2j * np.pi * np.outer(tone_hz, np.arange(len(taps))) / rate_hz) @ taps
    assert 20 * np.log10(abs(gain) * curve.peak_m_per_s2(tone_hz)) == pytest.approx(
        np.zeros(60), abs=TOLERANCE_DB[curve.name]
    )
    response = np.fft.fft(taps, 1 << 18)
    assert np.log(abs(response)).mean() == pytest.approx(np.log(taps[0]), abs=1e-3)
