"""Laws of the sampled plants: the nominal one first, spread as asked, seeded, their own mirror image."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import qmc

from base.arrays import Array
from engine.device import Device, FittedValue, Spread, Uncertainty
from precompute.sampling.plants import Scenarios, latin_hypercube, sample_scenarios
from tests.precompute.devices import any_device, mirrored, shipped

POSITION_M = (20e-3, 90e-3, 120e-3)


def solid(scenarios: Scenarios) -> Array:
    """Shape (scenario, parameter): of the bar and the actuators."""
    columns = (scenarios.bar_stiffness, scenarios.bar_mass, scenarios.stiffness, scenarios.mass)
    return np.column_stack(columns)


def soft(scenarios: Scenarios, position_m: tuple[float, ...] = POSITION_M) -> Array:
    """Shape (parameter, scenario, finger): factors on the finger of the device."""
    finger, placed = scenarios.device.finger, scenarios.place(position_m)
    return np.stack(
        [
            placed.mass_kg / finger.mass_kg,
            placed.damping_n_s_per_m / finger.damping_n_s_per_m,
            placed.stiffness_n_per_m / finger.stiffness_n_per_m,
        ]
    )


@any_device
def test_the_samples_have_the_spreads_asked_for(device: Device) -> None:
    spread = Spread(stiffness=0.02, mass=0.01, finger=0.3, finger_position_m=0.004)
    scenarios = sample_scenarios(replace(device, spread=spread), 2000, 5)
    count = len(device.actuators)
    deviation = [0.02, 0.01, *[0.02] * count, *[0.01] * count]
    assert solid(scenarios)[1:].std(axis=0) == pytest.approx(deviation, rel=0.02)
    assert solid(scenarios)[1:].mean(axis=0) == pytest.approx(np.ones(len(deviation)), abs=1e-3)
    assert abs(soft(scenarios) - 1).max() <= 0.3 and soft(scenarios)[:, 1:].std() == pytest.approx(
        0.3 / np.sqrt(3), rel=0.01
    )
    for tolerance_m, reach_m in ((None, 0.004), (0.001, 0.001)):
        off_m = abs(scenarios.place(POSITION_M, tolerance_m).position_m - POSITION_M)
        assert off_m.max(axis=0) == pytest.approx([reach_m] * 3, rel=1e-2) and (off_m <= reach_m + 1e-12).all()


@pytest.mark.parametrize("name", ["reference-a", "reference-p"])
def test_a_set_of_spreads_is_what_is_sampled(name: str) -> None:
    """Lengths are few (`_LENGTHS`), so that their standard deviation is 0.94 of what is asked."""
    device = shipped(name).with_values({"spread": "hand"})
    spread, scenarios = device.spread, sample_scenarios(device, 2000, 5)
    sampled = [scenarios.device_of(i) for i in range(1, len(scenarios))]
    length = np.array([[each.surface.length_m, each.surface.width_m] for each in sampled])
    length /= device.surface.length_m, device.surface.width_m
    assert length[:, 0].std() == pytest.approx(0.94 * spread.length, rel=0.02)
    assert np.ptp(length[:, 1]) == pytest.approx(np.ptp(length[:, 0]) if name == "reference-p" else 0.0, abs=1e-12)
    damping = np.array(
        [
            [each.surface.mass_damping_per_s, each.surface.stiffness_damping_s]
            + [actuator.damping_n_s_per_m for actuator in each.actuators]
            for each in sampled
        ]
    )
    assert np.log(damping).std(axis=0) == pytest.approx(spread.damping, rel=0.02)
    assert (scenarios.gain[1:] - 1).std(axis=0) == pytest.approx(spread.gain, rel=0.02)
    clamp_m = np.array([[actuator.clamp_m for actuator in each.actuators] for each in sampled])
    assert np.ptp(clamp_m, axis=0) == pytest.approx(spread.clamp_m * (name == "reference-a"), rel=0.01)
    assert abs(scenarios.delay_s).max(axis=0) == pytest.approx(spread.delay_s, rel=0.01)
    assert scenarios.normal[1:].std(axis=0).min() > 0.5, "every parameter varies"
    factors = np.sort(soft(scenarios).ravel())
    assert np.mean((factors > 1 / device.finger.spread) & (factors < device.finger.spread)) == pytest.approx(
        0.95, abs=0.01
    )
    assert np.median(factors) == pytest.approx(1.0, rel=0.02)
    off_m = scenarios.place(POSITION_M).position_m - POSITION_M
    assert abs(off_m.real).max() == pytest.approx(spread.finger_position_m + 0.025 * spread.speed_m_per_s, rel=0.01)
    nominal = replace(scenarios.device_of(0), text="", zones=())
    assert nominal == replace(device, text="", zones=())


def test_what_a_calibration_has_fitted_does_not_vary_further() -> None:
    device = shipped("reference-a").with_values({"spread": "lab"})
    fitted = tuple(FittedValue(name, 0.1, 10.0, 0.0) for name in ("actuator[1].damping", "actuator.full_scale"))
    known = replace(device, uncertainty=Uncertainty(fitted[:1], ((1e-12,),)))
    damping = [sample_scenarios(known, 20, 5).device_of(i).actuators for i in range(1, 21)]
    assert np.ptp([one.damping_n_s_per_m for one, _ in damping]) < 1e-5
    assert np.ptp([other.damping_n_s_per_m for _, other in damping]) > 0.01


def test_no_finger_lies_beside_the_bar() -> None:
    device = shipped("reference-a")
    length_m = device.bar.length_m
    fingers = sample_scenarios(device, 200, seed=1).place((0.0, length_m), 0.004)
    assert (fingers.position_m >= 0).all() and (fingers.position_m <= length_m).all()
    assert np.ptp(fingers.position_m, axis=0) == pytest.approx([0.004, 0.004], rel=0.02)


@any_device
def test_a_mirrored_bar_gets_the_mirrored_plants(device: Device) -> None:
    here, there = (sample_scenarios(each, 12, seed=3) for each in (device, mirrored(device)))
    order = np.r_[0, np.arange(1, 13).reshape(6, 2)[:, ::-1].ravel()]
    assert solid(there)[order] == pytest.approx(solid(here))
    assert not (solid(sample_scenarios(device, 12, seed=4))[1:] == solid(here)[1:]).any()
    length_m = device.bar.length_m
    turned_m = tuple(length_m - at_m for at_m in POSITION_M[::-1])
    assert soft(there, turned_m)[:, order, ::-1] == pytest.approx(soft(here))
    here_m, there_m = here.place(POSITION_M).position_m, there.place(turned_m).position_m
    assert length_m - there_m[order, ::-1] == pytest.approx(here_m)


def test_what_a_calibration_has_fitted_varies_as_that_has_left_it_and_only_so() -> None:
    """Two stiffnesses and the modulus, known to 0.2 %, those of the actuators together."""
    base = shipped("reference-a")
    names = ("actuator[1].stiffness", "actuator[2].stiffness", "bar.youngs_modulus")
    values = [base.actuators[0].stiffness_n_per_m, base.actuators[1].stiffness_n_per_m, base.bar.youngs_modulus_pa]
    covariance = 4e-6 * np.array([[1.0, 0.9, 0.0], [0.9, 1.0, 0.0], [0.0, 0.0, 1.0]])
    fitted = tuple(FittedValue(name, 0.5 * value, 2 * value, 0.0) for name, value in zip(names, values, strict=True))
    device = replace(base, uncertainty=Uncertainty(fitted, tuple(map(tuple, covariance.tolist()))))
    scenarios = sample_scenarios(device, 800, seed=3)
    found = [scenarios.device_of(s) for s in range(len(scenarios))]
    stiffness = np.log([[a.stiffness_n_per_m for a in each.actuators] + [each.bar.youngs_modulus_pa] for each in found])
    assert np.cov(stiffness[1:].T) == pytest.approx(covariance, rel=0.2, abs=5e-7)
    assert stiffness.mean(axis=0) == pytest.approx(np.log(values), abs=1e-3)
    density = np.array([each.bar.density_kg_per_m3 for each in found]) / base.bar.density_kg_per_m3
    assert density[1:].std() == pytest.approx(base.spread.mass, rel=0.05)
    assert found[0] == device
    assert (stiffness[1::2] == stiffness[2::2]).all()  # mirror images are the same bar


@pytest.mark.parametrize("count", [1, 20, 150])
def test_the_latin_hypercube_is_that_of_scipy_to_the_bit(count: int) -> None:
    """So that the plants of a seed, and what was published of them, stay the same."""
    mine = latin_hypercube(count, 6, np.random.default_rng(3))
    assert (mine == qmc.LatinHypercube(6, seed=3).random(count)).all()
