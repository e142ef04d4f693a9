"""Bolts that clamp: an exactly rigid stretch of bar in every figure that follows from the model."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import simpson
from scipy.linalg import eigh
from scipy.optimize import brentq

from base.arrays import Array
from engine.device import Device, Zone
from engine.device.parts import FittedValue, Uncertainty
from precompute.clicks.click_plants import _sampled_modes
from precompute.model.assembly import assemble, assemble_bar, build_mesh, dense
from precompute.model.modal import compute_basis
from precompute.model.response import solve_response
from precompute.sampling.plants import sample_scenarios
from tests.precompute.dense_model import element_integral
from tests.precompute.devices import shipped, with_bar

REF_A = shipped("reference-a")


def clamped(device: Device, *clamp_m: float) -> Device:
    """The device with these clamps, the last one for all actuators that are left."""
    each = [*clamp_m, *[clamp_m[-1]] * len(device.actuators)]
    pairs = zip(device.actuators, each, strict=False)
    return replace(device, actuators=tuple(replace(own, clamp_m=m) for own, m in pairs))


def natural_hz(device: Device, modes: int = 10) -> Array:
    return np.sqrt(compute_basis(assemble(device), modes).square_omega) / (2 * np.pi)


def stiffened_hz(device: Device, times: float, element_m: float, modes: int = 10) -> Array:
    """Natural frequencies of an independent model: integrals of Hermite's polynomials on a mesh of its own.

    The clamps are stretches of bar that are `times` as stiff.
    """
    bar, actuators = device.bar, device.actuators
    ends_m = [actuator.clamped_m(bar.length_m) for actuator in actuators]
    edges_m = sorted(
        {0.0, bar.length_m, *(m for ends in ends_m for m in ends), *(a.position_m.real for a in actuators)}
    )
    node_m = np.unique(
        np.concatenate(
            [np.linspace(a, b, 1 + int(np.ceil((b - a) / element_m))) for a, b in itertools.pairwise(edges_m)]
        )
    )
    K, M = np.zeros((2, 2 * len(node_m), 2 * len(node_m)))
    for e, (start_m, stop_m) in enumerate(itertools.pairwise(node_m)):
        middle_m, part = (start_m + stop_m) / 2, slice(2 * e, 2 * e + 4)
        stiff = times if any(first < middle_m < last for first, last in ends_m) else 1.0
        bending = stiff * bar.youngs_modulus_pa * bar.width_m * bar.thickness_m**3 / 12
        K[part, part] += bending * element_integral(round(stop_m - start_m, 15), derivative=2)
        M[part, part] += (
            bar.density_kg_per_m3
            * bar.width_m
            * bar.thickness_m
            * element_integral(round(stop_m - start_m, 15), derivative=0)
        )
    for actuator in actuators:
        dof = 2 * int(np.abs(node_m - actuator.position_m).argmin())
        K[dof, dof] += actuator.stiffness_n_per_m
        M[dof, dof] += actuator.mass_kg
    return np.sqrt(eigh(K, M, eigvals_only=True, subset_by_index=(0, modes - 1))) / (2 * np.pi)


def test_the_clamp_is_the_limit_of_a_stretch_that_is_stiffer_and_stiffer() -> None:
    """One clamp reaches beyond an end of the bar; meshes differ, and the distance falls as 1 / stiffness."""
    device = with_bar(clamped(REF_A, 0.02), largest_element_m=2.5e-3)
    rigid = natural_hz(device)
    near, nearer = (1 - stiffened_hz(device, times, 3e-3) / rigid for times in (30.0, 300.0))
    assert near.max() < 1e-2 and nearer.max() < 1e-3
    seen = near > 5e-4
    assert seen.sum() == 8 and near[seen] / nearer[seen] == pytest.approx(10, rel=0.1)
    assert (rigid / natural_hz(REF_A) - 1).max() > 0.15


def test_a_bar_that_is_held_in_its_middle_is_two_cantilevers() -> None:
    """Euler and Bernoulli's closed form: modes that are even about the clamp do not turn it, and a spring holds it."""
    bar, held = REF_A.bar, replace(REF_A.actuators[0], position_m=REF_A.bar.length_m / 2, stiffness_n_per_m=1e12)
    device = replace(REF_A, actuators=(replace(held, clamp_m=0.03),))
    reach_m = (bar.length_m - 0.03) / 2
    wave = [brentq(lambda x: np.cos(x) + 1 / np.cosh(x), low, low + 2) for low in (1.0, 4.0, 7.0)]
    speed = np.sqrt(bar.youngs_modulus_pa / bar.density_kg_per_m3 / 12) * bar.thickness_m  # sqrt(EI / rho A)
    basis = compute_basis(assemble(device), 8)
    ends = basis.at(np.array([0.0, bar.length_m]))
    even = np.sqrt(basis.square_omega[np.sign(ends[0]) == np.sign(ends[1])])
    assert even[:3] == pytest.approx((np.array(wave) / reach_m) ** 2 * speed, rel=1e-4)


@given(st.floats(1e-3, 0.06), st.floats(1.01, 1.5))
def test_every_frequency_rises_with_the_clamp(width_m: float, times: float) -> None:
    """A wider clamp is one constraint more on the same bar (Courant); 1e-6: of two meshes."""
    narrow, wide = (natural_hz(clamped(REF_A, width_m * factor)) for factor in (1.0, times))
    assert (wide >= narrow * (1 - 1e-6)).all() and wide[4] > narrow[4]


def test_without_a_clamp_no_bit_differs_and_a_narrow_one_hardly_matters() -> None:
    plain, own = assemble_bar(REF_A), assemble_bar(clamped(REF_A, 0.0))
    assert all((getattr(plain, key) == getattr(own, key)).all() for key in ("K", "C", "M"))
    assert (
        plain.size == 2 * len(plain.node_m) and (plain.element_dof[:, 0] == 2 * np.arange(len(plain.node_m) - 1)).all()
    )
    assert natural_hz(clamped(REF_A, 2e-4)) == pytest.approx(natural_hz(REF_A), rel=2e-3)
    text = REF_A.text.replace("[[actuator]]", '[[actuator]]\nclamp = "0 mm"')
    assert Device.parse(text, "text").fingerprint == REF_A.fingerprint
    assert Device.parse(text.replace("0 mm", "20 mm"), "text").fingerprint != REF_A.fingerprint


def test_a_symmetric_bar_stays_symmetric() -> None:
    left, length_m = REF_A.actuators[0], REF_A.bar.length_m
    pair = (left, replace(left, name="right", position_m=length_m - left.position_m))
    plant = assemble(clamped(replace(REF_A, actuators=pair), 0.02))
    places_m = np.linspace(0, length_m, 57)
    shapes = compute_basis(plant, 8).at(places_m)
    turned = np.sign(shapes[0]) * np.sign(shapes[-1])
    assert shapes[::-1] * turned == pytest.approx(shapes, abs=1e-5 * abs(shapes).max())
    moved = solve_response(plant, np.array([150.0])).acceleration(places_m)[0]
    assert moved[1, ::-1] == pytest.approx(moved[0], rel=1e-6)


def test_within_a_clamp_the_bar_is_straight_and_its_energy_counts_in_the_zone_that_it_lies_in() -> None:
    device = clamped(REF_A, 0.02)
    at_m, length_m = device.actuators[0].position_m.real, device.bar.length_m
    device = replace(device, zones=(Zone("I", 0.0, at_m + 4e-3), Zone("II", at_m + 4e-3, length_m)))
    plant, own = assemble(device), np.linspace(at_m - 0.01, at_m + 0.01, 5)
    response = solve_response(plant, np.array([187.0]))
    inside = response.acceleration(own)[0]
    assert abs(np.diff(inside, 2)).max() < 1e-9 * abs(inside).max() < abs(np.diff(inside)).max()
    gram = plant.gram(response.displacement_m)[0]
    for zone, found in zip(device.zones, gram[:2], strict=True):
        # Straight in the clamp, cubic beside it: Simpson's rule stretch by stretch.
        edges_m = sorted(
            {zone.start_m, zone.stop_m, *(m for m in build_mesh(device) if zone.start_m < m < zone.stop_m)}
        )
        total = np.zeros((2, 2), dtype=complex)
        for start_m, stop_m in itertools.pairwise(edges_m):
            place_m = np.linspace(start_m, stop_m, 17)
            field = plant.sampler(place_m).sample(response.displacement_m)[0]
            total += simpson(field.conj()[:, None] * field[None], x=place_m)
        assert found == pytest.approx(total, rel=1e-6)


def test_inertial_actuators_clamp_too() -> None:
    """With a moving mass of 10 t they stand on the ground."""
    device = clamped(REF_A, 0.02)
    heavy = replace(device, actuators=tuple(replace(each, moving_mass_kg=1e4) for each in device.actuators))
    assert natural_hz(heavy, 12)[2:] == pytest.approx(natural_hz(device), rel=1e-5)


def test_sampled_bars_of_a_calibration_have_clamps_of_their_own() -> None:
    told = FittedValue("actuator[1].clamp", 5e-3, 40e-3, 0.0)
    device = replace(clamped(REF_A, 0.02), uncertainty=Uncertainty((told,), ((0.04,),)))
    scenarios = sample_scenarios(device, 4, 1)
    square_omega = _sampled_modes(scenarios, 12)[1]
    assert len({each.actuators[0].clamp_m for each in scenarios.calibrated}) == 3
    for index, found in enumerate(square_omega):
        exact = compute_basis(assemble(scenarios.device_of(index)), 8).square_omega
        assert found[:8] == pytest.approx(exact, rel=1e-3)


@given(st.floats(1e-7, 1e-3))
def test_a_zone_that_ends_beside_an_actuator_does_not_ruin_the_modes(gap_m: float) -> None:
    """A node 10 um from another lost the first mode by 9 % to rounding."""
    edge_m = REF_A.actuators[0].position_m.real + gap_m
    zones = (Zone("I", 0.0, edge_m), Zone("II", edge_m, REF_A.bar.length_m))
    assert natural_hz(replace(REF_A, zones=zones)) == pytest.approx(natural_hz(REF_A), rel=1e-3)
    assert abs(dense(assemble_bar(replace(REF_A, zones=zones)).K)).max() < 1e12
