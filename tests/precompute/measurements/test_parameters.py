"""Laws of the parameters: names, bounds, coordinates, and devices with other values."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from engine.device import Device
from precompute.measurements.parameters import (
    ParameterError,
    find_parameters,
    known_names,
    paper_names,
    parameter_unit,
    with_changes,
)
from tests.precompute.devices import random_device, shipped, with_actuators

DEVICE = shipped("reference-a")
PAPERS_SIX = (
    "actuator[1].stiffness",
    "actuator[2].stiffness",
    "actuator.damping",
    "actuator.full_scale",
    "bar.mass_damping",
    "bar.stiffness_damping",
)


def test_the_usual_ones_are_the_papers_six() -> None:
    assert paper_names(DEVICE) == PAPERS_SIX
    symbols = [parameter.symbol for parameter in find_parameters(DEVICE, PAPERS_SIX, {}, 0.0)]
    assert symbols == ["k_1", "k_2", "c", "alpha", "sigma", "eta"]


@pytest.mark.parametrize("name", known_names(DEVICE))
def test_every_name_changes_what_it_says_and_starts_where_the_device_is(name: str) -> None:
    device = with_actuators(DEVICE, clamp_m=0.02, delay_s=4e-5)
    (parameter,) = find_parameters(device, [name], {}, 2e-3)
    assert parameter.low <= parameter.start <= parameter.high
    changed = with_changes(device, {name: 1.5 * parameter.start})
    assert (changed == device) == (parameter.part == "sensor")
    if parameter.part != "sensor":
        (again,) = find_parameters(changed, [name], {}, 0.0)
        assert again.start == pytest.approx(1.5 * parameter.start, rel=1e-12)
    assert parameter_unit(DEVICE, name) == parameter.unit


@given(st.sampled_from(PAPERS_SIX), st.floats(1e-9, 1e6))
def test_a_coordinate_is_of_one_value_and_its_rate_is_its_derivative(name: str, value: float) -> None:
    (parameter,) = find_parameters(DEVICE, [name], {}, 0.0)
    x = parameter.coordinate(value)
    assert parameter.value_at(x) == pytest.approx(value, rel=1e-9)
    h = 1e-6
    numeric = (parameter.value_at(x + h) - parameter.value_at(x - h)) / (2 * h)
    assert parameter.rate_at(x) == pytest.approx(numeric, rel=1e-6)


def test_a_damping_of_0_may_be_fitted_and_its_coordinate_becomes_a_logarithm() -> None:
    (sigma,) = find_parameters(DEVICE, ["bar.mass_damping"], {}, 0.0)
    (damping,) = find_parameters(with_actuators(DEVICE, damping_n_s_per_m=0.0), ["actuator.damping"], {}, 0.0)
    assert damping.start == damping.low == sigma.coordinate(0.0) == 0.0
    assert sigma.coordinate(100.0) - sigma.coordinate(10.0) == pytest.approx(math.log(10), rel=1e-3)


@pytest.mark.parametrize(
    ("names", "bounds", "device", "message"),
    [
        (["actuator[1].stifness"], {}, DEVICE, "did you mean actuator[1].stiffness?"),
        (["bar.length"], {}, DEVICE, "cannot be fitted to reference-a; measure it"),
        (["actuator[1].position"], {}, DEVICE, "cannot be fitted to reference-a; measure it"),
        (["bar.thickness"], {}, DEVICE, "bar.youngs_modulus and bar.density stand for it"),
        (["actuator[3].mass"], {}, DEVICE, "'actuator[3].mass'"),
        (["bar[1].density"], {}, DEVICE, "cannot be fitted"),
        (["actuator.mass", "actuator[2].mass"], {}, DEVICE, "actuator[2].mass: is fitted as actuator.mass already"),
        (["bar.density"], {"bar.density": (2.0, 1.0)}, DEVICE, "bounds 2 to 1"),
        (["bar.density"], {"bar.density": (0.0, 1.0)}, DEVICE, "above 0"),
        (["bar.mass_damping"], {"bar.mass_damping": (-1.0, 1.0)}, DEVICE, "of at least 0"),
        (["bar.density"], {"bar.mass_damping": (0.0, 1.0)}, DEVICE, "bar.mass_damping: has bounds but is not fitted"),
        (["actuator.mass"], {}, with_actuators(DEVICE, mass_kg=0.0), "actuator.mass: is 0 in the description"),
        ([], {}, DEVICE, "no parameter is named"),
    ],
)
def test_what_cannot_be_fitted_is_refused_by_name(
    names: list[str], bounds: dict[str, tuple[float, float]], device: Device, message: str
) -> None:
    with pytest.raises(ParameterError) as caught:
        find_parameters(device, names, bounds, 0.0)
    assert message in str(caught.value)


def test_actuators_that_differ_by_design_are_fitted_each() -> None:
    names = paper_names(random_device(seed=3))
    assert {"actuator[3].stiffness", "actuator[2].damping", "actuator[1].full_scale"} <= set(names)
