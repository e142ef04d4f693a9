"""What the data leave open is said: parameters that do nothing, pairs that do the same, the drive that would help."""

import numpy as np
import pytest

from precompute.calibration.calibrate import Known, calibrate
from precompute.calibration.identifiability import advise, open_combinations
from precompute.calibration.measuring_plan import Accuracy
from precompute.measurements.simulate import Flaws
from tests.precompute.calibration.calibrations import DEVICE, noisy_calibration, published_calibration
from tests.precompute.measured import NAN, read_bar


def test_sigma_next_to_0_is_said_to_change_nothing_and_known_at_most() -> None:
    """1.008e-5 1/s: less than a 200 000th of the damping. The interval holds it, and all that explains as well."""
    stiffness, *_, sigma, _ = published_calibration().estimates
    assert (stiffness.known, sigma.known) == (Known.WELL, Known.AT_MOST)
    assert sigma.low <= DEVICE.bar.mass_damping_per_s <= sigma.high
    assert 0.5 < sigma.high < 50
    (combination,) = open_combinations(published_calibration())
    assert combination.text == "bar.mass_damping alone: it hardly changes what was measured"
    assert combination.singular_value < 2
    (advice,) = advise(published_calibration(), 0.0, Accuracy())
    assert advice.parameter == "bar.mass_damping"


def test_two_parameters_that_do_the_same_are_named_together() -> None:
    """Spring and mass of an actuator push alike at one frequency: only k - omega^2 m counts."""
    read = read_bar(DEVICE, {}, ((150, NAN),), Flaws(noise=0.2), points=12)
    found = calibrate(DEVICE, read, ["actuator[2].stiffness", "actuator[2].mass"], starts=1)
    (combination,) = open_combinations(found)
    assert combination.text == (
        "actuator[2].mass up with actuator[2].stiffness up: together they hardly change what was measured"
    )
    assert abs(found.correlation[0, 1]) > 0.95


def test_the_advised_drive_narrows_what_is_open_when_it_is_read() -> None:
    read = read_bar(DEVICE, {}, ((60, NAN),), Flaws(noise=0.1))
    names = ["actuator[1].stiffness", "actuator[2].stiffness", "bar.stiffness_damping"]
    found = calibrate(DEVICE, read, names, starts=1)
    (advice,) = (item for item in advise(found, 0.0, Accuracy()) if item.parameter == "bar.stiffness_damping")
    assert advice.drive_hz is not None
    more = read_bar(DEVICE, {}, ((60, NAN), advice.drive_hz), Flaws(noise=0.1))
    again = calibrate(DEVICE, more, names, starts=1).estimates[2]
    assert found.estimates[2].known is not Known.WELL
    assert again.standard_error < 0.7 * found.estimates[2].standard_error


def test_directions_are_unit_vectors_ordered_by_what_is_known_of_them() -> None:
    combinations = open_combinations(noisy_calibration())
    assert [c.singular_value for c in combinations] == sorted(c.singular_value for c in combinations)
    for combination in combinations:
        sizes = [*combination.parts.values()]
        assert np.linalg.norm(sizes) <= 1 + 1e-9
        assert sizes[0] == pytest.approx(max(sizes))
