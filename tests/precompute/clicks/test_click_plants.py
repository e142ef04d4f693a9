"""Laws of sampled plants: they are the time-domain plant, transformed; what modes and lines leave out is not felt."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from base.arrays import Array, Complex
from engine.device import Device
from engine.device.threshold import DEFAULT, shipped_threshold
from precompute.clicks.click_basis import EVALUATIONS_PER_SAMPLE, SAMPLE_RATE_HZ, lines_for, make_tones
from precompute.clicks.click_plants import SampledPlants, output_factor
from precompute.clicks.click_responses import Responses
from precompute.model.assembly import assemble
from precompute.model.damped_lines import SIGMA_PER_S, DampedLines
from precompute.model.modal import compute_basis
from precompute.model.transient import TransientPlant
from precompute.sampling.plants import Scenarios, sample_scenarios
from tests.precompute.clicks.click_cases import play_each
from tests.precompute.devices import any_device, damped_as_assembly, shipped, with_inertial

POSITION_M = (31e-3, 118e-3)
"""Of the fingers: in no middle, and on every bar."""
LENGTH_S = 0.02
FINE = 24
"""Steps of the time-domain plant for each sample of the waveform."""


def drive_of(device: Device) -> Array:
    tones = make_tones(device, LENGTH_S)
    return tones.waveform(np.random.default_rng(1).normal(size=len(tones.wave)))


def responses_of(scenarios: Scenarios, modes: int | None = None, **changes: Any) -> Responses:
    lines = replace(lines_for(scenarios.device, LENGTH_S), **changes)
    plants = SampledPlants(scenarios, lines, modes)
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


@any_device
def test_fingers_feel_what_the_time_domain_plant_does_weighted(device: Device) -> None:
    timely = device.with_values({"spread": "hand"}).with_values({"spread.delay": "0 s"})
    others = (timely, (1, 3)), (damped_as_assembly(device), (1,)), (with_inertial(device), (1,))
    for plant, numbers in ((device, (0, 1, 3)), *others):
        scenarios, waveform = sample_scenarios(plant, 4, seed=2), drive_of(plant)
        responses = responses_of(scenarios)
        drive = responses.lines.transform(waveform)
        for scenario in numbers:
            found = (responses.transfer[scenario] * drive).sum(axis=1)
            expected = transient_lines(scenarios, scenario, waveform, responses.lines)
            assert abs(found - expected).max() <= 2e-3 * abs(expected).max()


def test_a_shorter_bar_among_the_samples_has_modes_of_its_own() -> None:
    """A calibration may find another length: then no mode of the nominal bar fits."""
    device = shipped("reference-d")
    zone = replace(device.zones[-1], stop_m=device.zones[-1].stop_m - 2e-3)
    shorter = replace(
        device, surface=replace(device.bar, length_m=device.bar.length_m - 2e-3), zones=(*device.zones[:-1], zone)
    )
    scenarios = replace(sample_scenarios(device, 1, seed=2), calibrated=(device, shorter, shorter))
    expected = responses_of(replace(scenarios, device=shorter, calibrated=(shorter,) * 3))
    found = responses_of(scenarios)
    assert abs(found.transfer[1] - expected.transfer[1]).max() <= 1e-3 * abs(expected.transfer[1]).max()


def test_a_late_channel_turns_its_part_of_every_response() -> None:
    timely = shipped("reference-a").with_values({"spread": "lab"}).with_values({"spread.delay": "0 s"})
    scenarios = sample_scenarios(timely, 2, seed=2)
    late = replace(scenarios, delay_s=np.array([[0.0, 0.0], [20e-6, 0.0], [20e-6, -10e-6]]))
    found, expected = responses_of(late), responses_of(scenarios).transfer
    turned = expected * np.exp(-late.delay_s[:, None, :, None] * found.lines.s_per_s)
    assert abs(found.transfer - turned).max() <= 1e-5 * abs(expected).max()


@any_device
def test_a_click_is_felt_as_the_sum_of_its_tones_and_its_peaks_are_those_of_its_course(device: Device) -> None:
    scenarios, tones = sample_scenarios(device, 20, seed=2), make_tones(device, LENGTH_S)
    responses = responses_of(scenarios)
    weight = np.random.default_rng(4).normal(size=len(tones.wave))
    whole = responses.play(tones.waveform(weight))
    assert play_each(responses, tones) @ weight == pytest.approx(whole, abs=1e-4 * float(abs(whole).max()))
    assert responses.lines.course(responses.spectrum(tones.waveform(weight))) == pytest.approx(
        whole[..., ::EVALUATIONS_PER_SAMPLE], abs=1e-4 * float(abs(whole).max())
    )
    peaks = responses.peaks(tones.waveform(weight), (0, 1)) / abs(whole).max(axis=2)
    assert 20 * np.log10(peaks) == pytest.approx(0.0, abs=0.05)  # of the course at twice the rate
