"""Laws of the basis: what the transient plant does, weighted; tones in their band, at rest at both ends."""

from itertools import pairwise

import numpy as np
import pytest
import scipy.signal
from numpy.typing import NDArray

from engine.device import Device
from precompute.clicks.basis import (
    LOOK_RATE_HZ,
    LOOKS,
    PLAY_RATE_HZ,
    between,
    compute_bases,
    compute_responses,
    independent,
    make_tones,
)
from precompute.model.assembly import assemble
from precompute.model.modal import Basis, compute_basis
from precompute.model.threshold_filter import threshold_filter
from precompute.model.transient import TransientPlant
from precompute.sampling.plants import Scenarios, sample_scenarios
from tests.precompute.devices import every_device, shipped

Array = NDArray[np.float64]
DEVICES = every_device()
any_device = pytest.mark.parametrize("device", DEVICES.values(), ids=DEVICES)
TOUCHED = (0, 2)
LENGTH_S = 0.02


def drive_of(device: Device) -> Array:
    tones = make_tones(device, LENGTH_S)
    return tones.waveform(np.random.default_rng(1).normal(size=len(tones.wave)))


def transient(scenarios: Scenarios, basis: Basis, scenario: int, waveform: Array, steps: int) -> Array:
    """Shape (finger, time): the transient plant's acceleration through the taps of the weighting."""
    fingers = scenarios.fingers_of(scenario, TOUCHED)
    plant = TransientPlant(basis, np.array([position_m for position_m, _ in fingers]), LOOK_RATE_HZ)
    plant.touch(fingers)
    lines = between(waveform)
    course, _ = plant.run(np.pad(lines, ((0, 0), (0, steps - lines.shape[1]))).T)
    weighted: Array = scipy.signal.lfilter(threshold_filter(LOOK_RATE_HZ), [1.0], course, axis=0).T
    return weighted


@any_device
def test_fingers_feel_what_the_transient_plant_does_weighted(device: Device) -> None:
    scenarios, waveform = sample_scenarios(device, 4, seed=2), drive_of(device)
    bases = compute_bases(scenarios)
    responses = compute_responses(scenarios, bases, TOUCHED, LENGTH_S)
    for scenario, found in enumerate(responses.play(waveform)):
        expected = transient(scenarios, bases[scenario], scenario, waveform, responses.steps)
        assert abs(found - expected).max() <= 1e-6 * abs(expected).max()


@any_device
def test_the_modes_left_out_are_not_felt(device: Device) -> None:
    scenarios, waveform = sample_scenarios(device, 0, seed=2), drive_of(device)
    responses = compute_responses(scenarios, compute_bases(scenarios), TOUCHED, LENGTH_S)
    expected = transient(scenarios, compute_basis(assemble(device)), 0, waveform, responses.steps)
    assert abs(responses.play(waveform)[0] - expected).max() <= 5e-3 * abs(expected).max()


@any_device
def test_a_click_is_felt_as_the_sum_of_its_tones(device: Device) -> None:
    scenarios, tones = sample_scenarios(device, 2, seed=2), make_tones(device, LENGTH_S)
    responses = compute_responses(scenarios, compute_bases(scenarios), TOUCHED, LENGTH_S)
    weight = np.random.default_rng(4).normal(size=len(tones.wave))
    whole = responses.play(tones.waveform(weight))
    assert responses.play_each(tones) @ weight == pytest.approx(whole, abs=1e-9 * abs(whole).max())


@any_device
@pytest.mark.parametrize("length_s", [0.01, 0.02, 0.03, 0.04])
@pytest.mark.parametrize("crowding", [1.0, 1.5])
def test_tones_lie_in_the_band_evenly_as_close_as_asked(device: Device, length_s: float, crowding: float) -> None:
    tones = make_tones(device, length_s, crowding)
    time_s = (np.arange(tones.wave.shape[1]) - (tones.wave.shape[1] - 1) / 2) / PLAY_RATE_HZ
    window = np.cos(np.pi * time_s[1:-1] / length_s)
    for index, actuator in enumerate(device.actuators):
        cosines = tones.wave[tones.actuator == index][::2, 1:-1] / window
        step = np.arccos(np.clip(cosines[:, len(time_s) // 2], -1, 1))  # one sample after the middle
        found_hz = step * PLAY_RATE_HZ / (2 * np.pi)
        low_hz, high_hz = actuator.band_hz
        assert found_hz[0] - low_hz == pytest.approx(high_hz - found_hz[-1], abs=1e-6)
        assert 0 <= found_hz[0] - low_hz <= 0.5 / (crowding * length_s) + 1e-6
        assert all(b - a == pytest.approx(1 / (crowding * length_s)) for a, b in pairwise(found_hz.tolist()))


@pytest.mark.parametrize("crowding", [1.0, 1.5, 4.0])
def test_independent_tones_are_orthogonal_and_span_the_same(crowding: float) -> None:
    tones = make_tones(shipped("reference-a"), LENGTH_S, crowding)
    apart = independent(tones)
    for actuator in range(2):
        wave, new = (each.wave[each.actuator == actuator] for each in (tones, apart))
        products = new @ new.T
        assert products == pytest.approx(products[0, 0] * np.eye(len(new)), abs=1e-9 * products[0, 0])
        left = wave - (wave @ new.T / products[0, 0]) @ new
        assert abs(left).max() <= 1e-2
    assert len(apart.wave) <= len(tones.wave) and not apart.wave[:, [0, -1]].any()


def test_a_click_begins_and_ends_at_rest() -> None:
    waveform = drive_of(shipped("reference-a"))
    assert waveform.shape == (2, round(LENGTH_S * PLAY_RATE_HZ) + 1)
    assert not waveform[:, [0, -1]].any()


def test_between_samples_there_are_straight_lines() -> None:
    wave = np.random.default_rng(0).normal(size=(2, 7))
    fine = between(wave)
    assert fine[:, ::LOOKS] == pytest.approx(wave)
    assert fine == pytest.approx(np.stack([np.interp(np.arange(13) / 2, np.arange(7), row) for row in wave]))
