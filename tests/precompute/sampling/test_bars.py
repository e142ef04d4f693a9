"""Laws of the bars that a calibration leaves possible: what a drive does to each is what that bar's model says."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from engine.device import Device, FittedValue, Uncertainty
from precompute.model.assembly import assemble
from precompute.model.response import solve_response
from precompute.predict.performance import compute_figures
from precompute.sampling.bars import SampledBars, sample_bars
from precompute.sampling.fingers import SAMPLES
from tests.precompute.builder.test_build import SMALL
from tests.precompute.sampled import sample_fingers

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
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


def bars_of(device: Device) -> SampledBars:
    bars = sample_bars(device, sample_fingers(device))
    assert bars is not None
    return bars


def moved_on(bars: SampledBars, number: int, hz: Array) -> Complex:
    """Unit accelerations (frequency, actuator, finger) of one bar under its own fingers, by its own model."""
    fingers = bars.sampled.fingers(number + 1, TOUCHED)
    places_m = np.array([at for at, _ in fingers])
    plant = bars.plants[number].with_fingers(places_m.tolist(), [finger for _, finger in fingers])
    return solve_response(plant, hz).acceleration(places_m)


def test_a_bar_answers_as_its_own_model_with_its_own_fingers() -> None:
    device = calibrated(0.05, spread=0.02)
    bars = bars_of(device)
    power = bars.powers(TOUCHED, HZ, AMPLITUDE)
    for number in (0, 7, SAMPLES - 1):
        moved = np.einsum("aap->ap", moved_on(bars, number, HZ))  # each actuator at its tone
        size = abs(moved * AMPLITUDE[:, None]) / DEVICE.threshold.peak_m_per_s2(HZ)[:, None]
        assert power[number] == pytest.approx((size**2).sum(axis=0), rel=1e-9)


def test_tones_of_one_frequency_add_with_their_phases() -> None:
    device = calibrated(0.05)
    bars, one = bars_of(device), np.full(2, 150.0)
    power = bars.powers(TOUCHED, one, AMPLITUDE)
    moved = AMPLITUDE @ moved_on(bars, 3, one[:1])[0]
    assert power[3] == pytest.approx((abs(moved) / DEVICE.threshold.peak_m_per_s2(one[:1])) ** 2, rel=1e-9)


def test_where_nothing_is_unknown_of_the_bar_the_touches_are_left() -> None:
    device = calibrated(0.0)
    sampled = sample_fingers(device)
    figures = compute_figures(assemble(device), sampled, TOUCHED, HZ, AMPLITUDE)
    assert bars_of(device).powers(TOUCHED, HZ, AMPLITUDE) == pytest.approx(figures.power[1:], rel=1e-6)


def test_without_a_calibration_there_are_no_other_bars() -> None:
    assert sample_bars(DEVICE, sample_fingers(DEVICE)) is None
