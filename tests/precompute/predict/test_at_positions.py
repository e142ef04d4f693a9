"""Laws of figures at positions: those of a dense model and of the sampled cases, and rise times of an envelope."""

from dataclasses import replace

import numpy as np
import pytest

from base.arrays import Array
from engine.device import Device, FittedValue, Uncertainty
from precompute.model.assembly import assemble
from precompute.model.response import solve_response
from precompute.predict.at_positions import SAMPLES, PlacementFigures, SteadyDesigner, compute_powers, sample_bars
from tests.engine.steady.bound import DEVICES, designer_of
from tests.precompute.builder.test_table_build import SMALL
from tests.precompute.dense_model import DenseModel, drive_of
from tests.precompute.devices import any_device
from tests.precompute.sampled import fingers_of, sample_cases, threshold

POSITIONS_M, ROLES = (0.035, 0.12, 0.15), (True, False, False)
either = pytest.mark.parametrize("coherent", [True, False], ids=["coherent", "a tone each"])
LOOKED_AT = (0, 3, 20, 32)
SMALL_BAR = Device.parse(SMALL, "bar")
TOUCHED = (0, 2)
HZ, AMPLITUDE = np.array([150.0, 173.25]), np.array([1.0, 0.4 - 0.7j])
STIFFNESS = SMALL_BAR.actuators[0].stiffness_n_per_m


def figures_of(device: Device) -> PlacementFigures:
    return designer_of(device).solve(POSITIONS_M, ROLES, 10.0)


def touched_model(device: Device, positions_m: tuple[float, ...]) -> DenseModel:
    return DenseModel(device, [(at_m, device.finger) for at_m in positions_m])


@pytest.mark.parametrize("name", DEVICES)
def test_levels_are_those_of_a_dense_model_and_their_spread_that_of_the_sampled_cases(name: str) -> None:
    device = DEVICES[name]
    figures = figures_of(device)
    drive = figures.drive
    field = touched_model(device, POSITIONS_M).unit_acceleration(np.array([drive.frequency_hz]), np.array(POSITIONS_M))
    level_db = 20 * np.log10(abs(field[0] @ drive.complex_amplitudes) / threshold(drive.frequency_hz))
    assert figures.level_db == pytest.approx(level_db, abs=1e-3)
    assert figures.contrast_db == pytest.approx(level_db[0] - level_db[1:].max(), abs=1e-3)
    assert figures.level_db[0] == pytest.approx(drive.level_db[0], abs=0.05)
    sampled_db, spread = figures.sampled_level_db, figures.spread
    assert sampled_db.shape == (SAMPLES, len(POSITIONS_M))
    assert spread.felt.low_db < spread.felt.middle_db < spread.felt.high_db
    assert spread.quiet is not None and spread.contrast is not None
    contrast_db = sampled_db[:, 0] - sampled_db[:, 1:].max(axis=1)
    assert spread.contrast.low_db == pytest.approx(np.percentile(contrast_db, 5))
    assert figures.finger_percentiles(0) == spread.felt
    mean = (10 ** (sampled_db / 10)).mean(axis=0)
    assert figures.expected_contrast_db == pytest.approx(10 * np.log10(mean[0] / mean[1:].max()))


@any_device
@either
def test_powers_of_every_case_are_the_dense_models(device: Device, coherent: bool) -> None:
    """Powers of different tones, each over its threshold, add."""
    cases, (hz, amplitude) = sample_cases(device, (0, 2, 3)), drive_of(device, coherent)
    found, tones = compute_powers(assemble(device), cases, hz, amplitude), np.unique(hz)
    for case in LOOKED_AT:
        unit = DenseModel(device, fingers_of(cases, case)).unit_acceleration(tones, cases.position_m[case])
        each = abs(np.einsum("tpa,ta->tp", unit, np.where(hz == tones[:, None], amplitude, 0)))
        levels = each / np.array([threshold(tone) for tone in tones])[:, None]
        assert found[case] == pytest.approx((levels**2).sum(axis=0), rel=1e-5)


def calibrated(deviation: float, spread: float = 0.0) -> Device:
    """As if the stiffness of the first actuator had been fitted, its logarithm known within `deviation`."""
    fitted = (FittedValue("actuator[1].stiffness", STIFFNESS / 2, STIFFNESS * 2, 0.0),)
    return replace(
        SMALL_BAR,
        uncertainty=Uncertainty(fitted, ((deviation**2,),)),
        spread=replace(SMALL_BAR.spread, stiffness=spread, mass=spread),
    )


@pytest.mark.parametrize("hz", [HZ, HZ[[0, 0]]], ids=["a tone each", "one frequency"])
def test_a_bar_answers_as_its_own_model_with_its_own_fingers(hz: Array) -> None:
    (bars, _), tones = sample_bars(calibrated(0.05, spread=0.02), SAMPLES), np.unique(hz)
    assert len(bars) == SAMPLES
    weight, cases = np.where(hz == tones[:, None], AMPLITUDE, 0), sample_cases(SMALL_BAR, TOUCHED)
    for number in (0, 7, SAMPLES - 1):
        places_m, fingers = zip(*fingers_of(cases, number + 1), strict=True)
        plant = bars[number].with_fingers(places_m, fingers)
        moved = np.einsum("ta,tap->tp", weight, solve_response(plant, tones).acceleration(np.array(places_m)))
        size = abs(moved) / SMALL_BAR.threshold.peak_m_per_s2(tones)[:, None]
        assert compute_powers(bars[number], cases, hz, AMPLITUDE)[number + 1] == pytest.approx(
            (size**2).sum(axis=0), rel=1e-9
        )


def test_every_sampled_case_has_a_bar_of_its_own() -> None:
    device, felt = calibrated(0.05), (True, False)
    designer, positions_m = SteadyDesigner(device), [zone.middle_m for zone in device.zones[:2]]
    figures = designer.solve(positions_m, felt, 10.0)
    hz, amplitude = np.array(figures.drive.frequencies_hz), figures.drive.complex_amplitudes
    for number, bar in enumerate(sample_bars(device, SAMPLES)[0]):
        places_m, fingers = zip(*figures.loads[number + 1], strict=True)
        field = solve_response(bar.with_fingers(places_m, fingers), hz[:1]).acceleration(np.array(places_m))[0]
        level_db = 20 * np.log10(abs(amplitude @ field) / SMALL_BAR.threshold.peak_m_per_s2(hz[:1]))
        assert figures.sampled_level_db[number] == pytest.approx(level_db, abs=1e-6)


def test_where_nothing_is_unknown_of_the_bar_the_touches_are_left() -> None:
    cases = sample_cases(SMALL_BAR, TOUCHED)
    expected = compute_powers(assemble(SMALL_BAR), cases, HZ, AMPLITUDE)
    for bar in sample_bars(calibrated(0.0), 3)[0]:
        assert compute_powers(bar, cases, HZ, AMPLITUDE) == pytest.approx(expected, rel=1e-6)


def test_without_a_calibration_there_are_no_other_bars() -> None:
    assert sample_bars(SMALL_BAR, SAMPLES) == ([], None)
