"""Laws of the bars that a calibration leaves possible: what a drive does to each is what that bar's model says."""

from dataclasses import replace

import numpy as np
import pytest

from base.arrays import Array
from engine.device import Device, FittedValue, Uncertainty
from precompute.model.assembly import assemble
from precompute.model.response import solve_response
from precompute.predict.performance import compute_figures
from precompute.sampling.fingers import SAMPLES
from precompute.sampling.surfaces import SampledSurfaces, sample_surfaces
from tests.precompute.builder.test_table_build import SMALL
from tests.precompute.sampled import sample_fingers

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


def bars_of(device: Device) -> SampledSurfaces:
    bars = sample_surfaces(device, sample_fingers(device))
    assert bars is not None
    return bars


@pytest.mark.parametrize("hz", [HZ, HZ[[0, 0]]], ids=["a tone each", "one frequency"])
def test_a_bar_answers_as_its_own_model_with_its_own_fingers(hz: Array) -> None:
    bars, tones = bars_of(calibrated(0.05, spread=0.02)), np.unique(hz)
    power = bars.powers(TOUCHED, hz, AMPLITUDE)
    weight = np.where(hz == tones[:, None], AMPLITUDE, 0)
    for number in (0, 7, SAMPLES - 1):
        fingers = bars.sampled.fingers(number + 1, TOUCHED)
        places_m = np.array([at for at, _ in fingers])
        plant = bars.plants[number].with_fingers(places_m.tolist(), [finger for _, finger in fingers])
        moved = np.einsum("ta,tap->tp", weight, solve_response(plant, tones).acceleration(places_m))
        size = abs(moved) / DEVICE.threshold.peak_m_per_s2(tones)[:, None]
        assert power[number] == pytest.approx((size**2).sum(axis=0), rel=1e-9)


def test_where_nothing_is_unknown_of_the_bar_the_touches_are_left() -> None:
    device = calibrated(0.0)
    sampled = sample_fingers(device)
    figures = compute_figures(assemble(device), sampled, TOUCHED, HZ, AMPLITUDE)
    assert bars_of(device).powers(TOUCHED, HZ, AMPLITUDE) == pytest.approx(figures.power[1:], rel=1e-6)


def test_without_a_calibration_there_are_no_other_bars() -> None:
    assert sample_surfaces(DEVICE, sample_fingers(DEVICE)) is None
