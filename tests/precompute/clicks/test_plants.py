"""Laws of sampled plants: they are the time-domain plant, transformed; what modes and lines leave out is not felt."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from engine.device import Device
from engine.device.threshold import DEFAULT, shipped_threshold
from precompute.clicks.basis import EVALUATIONS_PER_SAMPLE, SAMPLE_RATE_HZ, lines_for, make_tones
from precompute.clicks.plants import SampledPlants, output_factor
from precompute.clicks.responses import Responses
from precompute.model.assembly import assemble
from precompute.model.damped_lines import SIGMA_PER_S, DampedLines
from precompute.model.modal import compute_basis
from precompute.model.transient import TransientPlant
from precompute.sampling.plants import Scenarios, sample_scenarios
from tests.precompute.dense_model import DenseModel
from tests.precompute.devices import damped_as_assembly, every_device, on_each, shipped

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
DEVICES = every_device()
any_device = on_each(DEVICES)
POSITION_M = (31e-3, 118e-3)
"""Of the fingers: in no middle, and on every bar."""
LENGTH_S = 0.02
FINE = 24
"""Steps of the time-domain plant for each sample of the waveform."""


def drive_of(device: Device) -> Array:
    tones = make_tones(device, LENGTH_S)
    return tones.waveform(np.random.default_rng(1).normal(size=len(tones.wave)))


def responses_of(scenarios: Scenarios) -> Responses:
    lines = lines_for(scenarios.device, LENGTH_S)
    plants = SampledPlants(scenarios, lines)
    return Responses(plants.transfer(plants.scenarios.place(POSITION_M)), lines)


def transient_lines(scenarios: Scenarios, scenario: int, waveform: Array, lines: DampedLines) -> Complex:
    """Lines (finger, line) of the weighted acceleration of the time-domain plant with 60 modes, by quadrature.

    Without the triangle of a sample, which the plant draws itself.
    """
    device = scenarios.device_of(scenario)
    fingers = scenarios.place(POSITION_M).of(scenario)
    rate_hz = FINE * SAMPLE_RATE_HZ
    places_m = np.array([position_m for position_m, _ in fingers])
    plant = TransientPlant(compute_basis(assemble(device), 60), places_m, rate_hz)
    plant.touch(fingers)
    at = np.arange((waveform.shape[1] - 1) * FINE + 1) / FINE
    moved = np.stack([np.interp(at, np.arange(waveform.shape[1]), row) for row in waveform], axis=1)
    steps = 2 * lines.size * FINE  # by then what rings on is faded by exp(-sigma t)
    acceleration, _ = plant.run(np.pad(moved, ((0, steps - len(moved)), (0, 0))))
    time_s = np.arange(steps) / rate_hz
    faded = acceleration.T * np.exp(-SIGMA_PER_S * time_s)
    spectrum = np.fft.rfft(faded)[:, ::2][:, : len(lines.s_per_s)] / FINE
    half = lines.s_per_s / (2 * lines.rate_hz)
    weighting = output_factor(lines, shipped_threshold(DEFAULT)) / (lines.s_per_s**2 * (np.sinh(half) / half) ** 2)
    weighted: Complex = spectrum * weighting
    return weighted


def assert_felt_as_in_time(device: Device, numbers: Sequence[int]) -> None:
    """What fingers feel in these scenarios is the weighted acceleration of the plant in time."""
    scenarios, waveform = sample_scenarios(device, 4, seed=2), drive_of(device)
    responses = responses_of(scenarios)
    drive = responses.lines.transform(waveform)
    for scenario in numbers:
        found = (responses.transfer[scenario] * drive).sum(axis=1)
        expected = transient_lines(scenarios, scenario, waveform, responses.lines)
        assert abs(found - expected).max() <= 2e-3 * abs(expected).max()


@any_device
def test_fingers_feel_what_the_time_domain_plant_does_weighted(device: Device) -> None:
    assert_felt_as_in_time(device, (0, 1, 3))


def test_damping_of_the_assembly_too_is_that_of_the_plant() -> None:
    assert_felt_as_in_time(damped_as_assembly(shipped("reference-a")), [1])


@any_device
def test_transfer_functions_are_those_of_the_finite_elements(device: Device) -> None:
    """The modes that do not move are static: of all modes, as dense matrices, nothing else is missing."""
    scenarios = sample_scenarios(device, 2, seed=2)
    responses = responses_of(scenarios)
    s, factor = responses.lines.s_per_s, output_factor(responses.lines, device.threshold)
    for scenario in range(3):
        fingers = scenarios.place(POSITION_M).of(scenario)
        model = DenseModel(scenarios.device_of(scenario), fingers)
        found, rows = responses.transfer[scenario], model.rows([at_m for at_m, _ in fingers])
        for line in range(0, len(s), 40):
            dynamic = model.K + s[line] * model.C + s[line] ** 2 * model.M
            moved = rows @ np.linalg.solve(dynamic, model.spring + s[line] * model.damper)
            assert abs(found[:, :, line] - moved * factor[line]).max() <= 2e-3 * abs(found).max()


@any_device
def test_a_course_does_not_come_round(device: Device) -> None:
    """Four times the period, and lines as fine: the same course."""
    scenarios, waveform = sample_scenarios(device, 1, seed=2), drive_of(device)
    short = responses_of(scenarios)
    lines = replace(short.lines, steps=4 * short.lines.steps)
    plants = SampledPlants(scenarios, lines)
    long = Responses(plants.transfer(plants.scenarios.place(POSITION_M)), lines)
    found, expected = short.play(waveform), long.play(waveform)[..., : short.steps]
    assert abs(found - expected).max() <= 2e-3 * abs(expected).max()


@any_device
def test_the_modes_and_lines_left_out_are_not_felt(device: Device) -> None:
    """Peaks within 0.02 dB of those with every mode and lines up to 0.49 of the sampling rate."""
    scenarios, waveform = sample_scenarios(device, 1, seed=2), drive_of(device)
    responses = responses_of(scenarios)
    lines = replace(responses.lines, top_hz=0.49 * SAMPLE_RATE_HZ)
    plants = SampledPlants(scenarios, lines, 40)
    all_of_it = Responses(plants.transfer(plants.scenarios.place(POSITION_M)), lines)
    found, expected = (abs(each.play(waveform)).max(axis=2) for each in (responses, all_of_it))
    assert 20 * np.log10(found / expected) == pytest.approx(0.0, abs=0.02)


def test_a_shorter_bar_among_the_samples_has_modes_of_its_own() -> None:
    """A calibration may find another length: then no mode of the nominal bar fits."""
    device = shipped("reference-d")
    zone = replace(device.zones[-1], stop_m=device.zones[-1].stop_m - 2e-3)
    shorter = replace(
        device, bar=replace(device.bar, length_m=device.bar.length_m - 2e-3), zones=(*device.zones[:-1], zone)
    )
    scenarios = replace(sample_scenarios(device, 1, seed=2), calibrated=(device, shorter, shorter))
    expected = responses_of(replace(scenarios, device=shorter, calibrated=(shorter,) * 3))
    found = responses_of(scenarios)
    assert abs(found.transfer[1] - expected.transfer[1]).max() <= 1e-3 * abs(expected.transfer[1]).max()


@any_device
def test_a_click_is_felt_as_the_sum_of_its_tones(device: Device) -> None:
    scenarios, tones = sample_scenarios(device, 2, seed=2), make_tones(device, LENGTH_S)
    responses = responses_of(scenarios)
    weight = np.random.default_rng(4).normal(size=len(tones.wave))
    whole = responses.play(tones.waveform(weight))
    assert responses.play_each(tones) @ weight == pytest.approx(whole, abs=1e-4 * float(abs(whole).max()))
    assert responses.play_samples(tones.waveform(weight)) == pytest.approx(
        whole[..., ::EVALUATIONS_PER_SAMPLE], abs=1e-4 * float(abs(whole).max())
    )


@any_device
def test_peaks_are_those_of_the_course(device: Device) -> None:
    """Of the course at twice the rate, to 0.05 dB."""
    scenarios, waveform = sample_scenarios(device, 20, seed=2), drive_of(device)
    responses = responses_of(scenarios)
    expected = abs(responses.play(waveform)).max(axis=2)
    assert 20 * np.log10(responses.peaks(waveform, (0, 1)) / expected) == pytest.approx(0.0, abs=0.05)
