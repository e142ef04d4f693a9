"""Laws of the bars that a calibration leaves possible: what a drive does to each is what that bar's model says."""

from dataclasses import replace

import numpy as np
import pytest

from base.arrays import Array
from engine.device import Device, FittedValue, Uncertainty
from precompute.model.assembly import assemble
from precompute.model.response import solve_response
from precompute.predict.at_positions import SAMPLES, SteadyDesigner, compute_powers, sample_bars
from tests.precompute.builder.test_table_build import SMALL
from tests.precompute.sampled import fingers_of, sample_cases

DEVICE = Device.parse(SMALL, "bar")
TOUCHED = (0, 2)
HZ, AMPLITUDE = np.array([150.0, 173.25]), np.array([1.0, 0.4 - 0.7j])
STIFFNESS = DEVICE.actuators[0].stiffness_n_per_m


def calibrated(deviation: float, spread: float = 0.0) -> Device:
    """As if the stiffness of the first actuator had been fitted, its logarithm known within `deviation`."""
    fitted = (FittedValue("actuator[1].stiffness", STIFFNESS / 2, STIFFNESS * 2, 0.0),)
    return replace(
        DEVICE,
        uncertainty=Uncertainty(fitted, ((deviation**2,),)),
        spread=replace(DEVICE.spread, stiffness=spread, mass=spread),
    )


@pytest.mark.parametrize("hz", [HZ, HZ[[0, 0]]], ids=["a tone each", "one frequency"])
def test_a_bar_answers_as_its_own_model_with_its_own_fingers(hz: Array) -> None:
    (bars, _), tones = sample_bars(calibrated(0.05, spread=0.02), SAMPLES), np.unique(hz)
    assert len(bars) == SAMPLES
    weight, cases = np.where(hz == tones[:, None], AMPLITUDE, 0), sample_cases(DEVICE, TOUCHED)
    for number in (0, 7, SAMPLES - 1):
        places_m, fingers = zip(*fingers_of(cases, number + 1), strict=True)
        plant = bars[number].with_fingers(places_m, fingers)
        moved = np.einsum("ta,tap->tp", weight, solve_response(plant, tones).acceleration(np.array(places_m)))
        size = abs(moved) / DEVICE.threshold.peak_m_per_s2(tones)[:, None]
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
        level_db = 20 * np.log10(abs(amplitude @ field) / DEVICE.threshold.peak_m_per_s2(hz[:1]))
        assert figures.sampled_level_db[number] == pytest.approx(level_db, abs=1e-6)


def test_where_nothing_is_unknown_of_the_bar_the_touches_are_left() -> None:
    cases = sample_cases(DEVICE, TOUCHED)
    expected = compute_powers(assemble(DEVICE), cases, HZ, AMPLITUDE)
    for bar in sample_bars(calibrated(0.0), 3)[0]:
        assert compute_powers(bar, cases, HZ, AMPLITUDE) == pytest.approx(expected, rel=1e-6)


def test_without_a_calibration_there_are_no_other_bars() -> None:
    assert sample_bars(DEVICE, SAMPLES) == ([], None)
