"""Laws of the doubt about the sign of responses."""

from dataclasses import replace

import numpy as np
import pytest

from precompute.calibration.polarity import polarity_doubt
from precompute.measurements import Kind, Measurements
from precompute.measurements.parameters import find_parameters
from tests.precompute.devices import shipped
from tests.precompute.measured import NAN, read_bar

DEVICE = shipped("reference-a")
HZ = (66.0, 90, 110, 140, 170, 209, 230, 284)
NAMES = ("bar.youngs_modulus", "bar.density", "actuator[1].stiffness", "actuator[2].stiffness")


def responses_of(factors: tuple[float, ...] = (), signs: tuple[float, float] = (1.0, 1.0)) -> Measurements:
    """Each actuator alone at every frequency and place, of a bar whose values are wrong by these factors."""
    named = zip(find_parameters(DEVICE, NAMES, {}, 0.0), factors, strict=False)
    truth = {parameter.name: parameter.start * factor for parameter, factor in named}
    drives_hz = [drive for hz in HZ for drive in ((hz, NAN), (NAN, hz))]
    read = read_bar(DEVICE, truth, drives_hz, points=3, kind=Kind.RESPONSE)
    return replace(read, acceleration=read.acceleration * ((read.amplitude != 0) @ np.array(signs)))


@pytest.mark.parametrize(
    ("signs", "named"),
    [((1.0, 1.0), ""), ((-1.0, -1.0), "the sensor"), ((-1.0, 1.0), "plug of left"), ((1.0, -1.0), "plug of right")],
)
def test_a_sign_that_is_turned_is_named_by_what_turns_it(signs: tuple[float, float], named: str) -> None:
    doubt = polarity_doubt(DEVICE, responses_of(signs=signs))
    assert named in doubt and bool(doubt) == bool(named)


def test_a_bar_with_other_values_is_not_taken_for_a_turned_one() -> None:
    for seed in range(20):
        factors = 2 ** np.random.default_rng(seed).uniform(-1, 1, len(NAMES))
        assert polarity_doubt(DEVICE, responses_of(tuple(factors.tolist()))) == ""


def test_peaks_have_no_sign() -> None:
    found = responses_of(signs=(-1.0, -1.0))
    peaks = replace(found, kind=Kind.PEAK, acceleration=abs(found.acceleration).astype(np.complex128))
    assert polarity_doubt(DEVICE, peaks) == ""
