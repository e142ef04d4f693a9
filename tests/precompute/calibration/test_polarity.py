"""Laws of the doubt about the sign of responses."""

from dataclasses import replace

import numpy as np
import pytest

from engine.device import Device
from precompute.calibration.polarity import polarity_doubt
from precompute.measurements import Kind, Measurements, lay_out
from precompute.measurements.model import MeasurementModel
from tests.precompute.devices import shipped

DEVICE = shipped("reference-a")
PLACES_M, HZ = np.linspace(0.01, 0.27, 3), np.array([66.0, 90, 110, 140, 170, 209, 230, 284])


def responses_of(bar: Device, signs: tuple[float, float] = (1.0, 1.0)) -> Measurements:
    """Each actuator alone at every frequency and place."""
    drive = np.kron(HZ[:, None], np.where(np.eye(2) > 0, 1.0, np.nan))
    layout = lay_out(drive, PLACES_M, 2e-3, Kind.RESPONSE)
    acceleration = np.exp(MeasurementModel(bar, layout, ()).predict(np.zeros(0)).log_acceleration).astype(np.complex128)
    return replace(layout, acceleration=acceleration * ((layout.amplitude != 0) @ np.array(signs)))


def other_bar(seed: int) -> Device:
    """A bar whose values are wrong by up to a factor of two."""
    factor = np.exp(np.random.default_rng(seed).uniform(-np.log(2), np.log(2), 4)).tolist()
    bar = DEVICE.bar
    made = replace(
        bar, youngs_modulus_pa=bar.youngs_modulus_pa * factor[0], density_kg_per_m3=bar.density_kg_per_m3 * factor[1]
    )
    stiffness = zip(DEVICE.actuators, factor[2:], strict=True)
    springs = (replace(each, stiffness_n_per_m=each.stiffness_n_per_m * by) for each, by in stiffness)
    return replace(DEVICE, bar=made, actuators=tuple(springs))


@pytest.mark.parametrize(
    ("signs", "named"),
    [((1.0, 1.0), ""), ((-1.0, -1.0), "the sensor"), ((-1.0, 1.0), "plug of left"), ((1.0, -1.0), "plug of right")],
)
def test_a_sign_that_is_turned_is_named_by_what_turns_it(signs: tuple[float, float], named: str) -> None:
    doubt = polarity_doubt(DEVICE, responses_of(DEVICE, signs))
    assert named in doubt and bool(doubt) == bool(named)


def test_a_bar_with_other_values_is_not_taken_for_a_turned_one() -> None:
    assert [polarity_doubt(DEVICE, responses_of(other_bar(seed))) for seed in range(20)] == [""] * 20


def test_peaks_have_no_sign() -> None:
    found = responses_of(DEVICE, (-1.0, -1.0))
    assert (
        polarity_doubt(
            DEVICE, replace(found, kind=Kind.PEAK, acceleration=abs(found.acceleration).astype(np.complex128))
        )
        == ""
    )
