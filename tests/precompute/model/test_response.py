"""Laws of the unit responses: numpy twin of the kernel, reciprocity, statics, energy, fingers, mirror, similarity."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from engine.device import Device
from precompute.model.assembly import BANDWIDTH, Plant, assemble, dense
from precompute.model.band_solver import solve_banded
from precompute.model.gram import compute_gram
from precompute.model.response import Response, solve_response
from tests.precompute.dense_model import DenseModel
from tests.precompute.devices import (
    every_device,
    mirrored,
    on_each,
    random_device,
    scaled,
    shipped,
    unhurried,
    with_actuators,
    with_bar,
)

Complex = NDArray[np.complex128]
FREQUENCY_HZ = np.array([12.5, 60.0, 121.8, 140.0, 179.35, 208.57, 300.0, 950.0])
any_device = on_each(every_device())


def dynamic_stiffness(plant: Plant, frequency_hz: float) -> Complex:
    omega = 2 * np.pi * frequency_hz
    return (dense(plant.K) - omega**2 * dense(plant.M)).astype(np.complex128) + 1j * omega * dense(plant.C)


def loads(device: Device, frequency_hz: NDArray[np.float64]) -> Complex:
    """Force (frequency, actuator) of the moving bases on a bar at rest: (k + j omega c) alpha."""
    k, c, alpha = np.array([(a.stiffness_n_per_m, a.damping_n_s_per_m, a.full_scale_m) for a in device.actuators]).T
    force: Complex = (k + 2j * np.pi * frequency_hz[:, None] * c) * alpha
    return force


def assert_close(found: Complex, expected: NDArray[np.complexfloating], relative: float) -> None:
    """Within `relative` of the largest value of the row."""
    error = np.abs(found - expected) / np.abs(expected).max(axis=-1, keepdims=True)
    assert error.max() <= relative


@any_device
def test_banded_solve_equals_numpys_dense_solve(device: Device) -> None:
    plant = assemble(device)
    found = solve_response(plant, FREQUENCY_HZ).displacement_m
    for row, force, frequency_hz in zip(found, loads(device, FREQUENCY_HZ), FREQUENCY_HZ, strict=True):
        right = np.zeros((plant.size, len(device.actuators)), dtype=complex)
        right[plant.actuator_dof, np.arange(len(device.actuators))] = force
        expected = np.linalg.solve(dynamic_stiffness(plant, frequency_hz), right).T
        assert_close(row[:, 0::2], expected[:, 0::2], 1e-8)
        assert_close(row[:, 1::2], expected[:, 1::2], 1e-8)


@unhurried
@given(st.integers(1, 40), st.integers(0, 2**32))
def test_banded_kernel_solves_any_band_even_where_pivots_are_small(size: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    K, C, M = random.normal(size=(3, BANDWIDTH + 1, size))
    K[-1] *= random.choice([0.0, 1e-12, 1.0], size)  # diagonal that only pivoting survives
    C[-1] *= 1e-3
    M[-1] = 0.0
    dof, spring, damper = np.array([size // 2]), np.array([1.5]), np.array([0.25])
    out = np.zeros((2, 1, size), dtype=complex)
    omega = np.array([0.3, 2.0])
    weight = np.zeros((1, 4))
    weight[0, : min(4, size - size // 2)] = random.normal(size=min(4, size - size // 2))
    solve_banded(K, C, M, omega, dof, weight, spring, damper, out)
    for w, found in zip(omega, out[:, 0], strict=True):
        matrix = dense(K) + 1j * w * dense(C) - w * w * dense(M)
        right = np.zeros(size, dtype=complex)
        right[size // 2 : size // 2 + 4] = (1.5 + 0.25j * w) * weight[0, : size - size // 2]
        scale = np.abs(matrix).sum(axis=1).max() * np.abs(found).max() + np.abs(right).max()
        assert np.abs(matrix @ found - right).max() <= 1e-12 * scale


@any_device
def test_a_touched_points_column_is_the_receptance_of_a_unit_force_there(device: Device) -> None:
    plant = assemble(device)
    places_m = np.array([0.0, 0.31, 0.77, 1.0]) * device.bar.length_m
    found = solve_response(plant, FREQUENCY_HZ, places_m).displacement_m
    assert (found[:, : len(device.actuators)] == solve_response(plant, FREQUENCY_HZ).displacement_m).all()
    rows = DenseModel(device).rows(places_m)
    for row, frequency_hz in zip(found[:, len(device.actuators) :], FREQUENCY_HZ, strict=True):
        expected = np.linalg.solve(dynamic_stiffness(plant, frequency_hz), rows.T.astype(complex)).T
        assert_close(row[:, 0::2], expected[:, 0::2], 1e-8)
    at_points = found[:, len(device.actuators) :] @ rows.T
    assert_close(at_points, at_points.swapaxes(1, 2), 1e-8)  # reciprocity


@any_device
def test_each_frequency_is_solved_on_its_own(device: Device) -> None:
    plant = assemble(device)
    together = solve_response(plant, FREQUENCY_HZ).displacement_m
    for i, frequency_hz in enumerate(FREQUENCY_HZ):
        assert (solve_response(plant, np.array([frequency_hz])).displacement_m[0] == together[i]).all()


@any_device
def test_reciprocity(device: Device) -> None:
    """Actuator a's deflection by a force at b is b's by the same force at a: with and without a finger."""
    free = assemble(device)
    for plant in (free, free.with_fingers([0.3 * device.bar.length_m], device.finger)):
        displacement = solve_response(plant, FREQUENCY_HZ).displacement_m
        receptance = displacement[:, :, plant.actuator_dof] / loads(device, FREQUENCY_HZ)[:, :, None]
        swapped = receptance.transpose(0, 2, 1)
        assert_close(receptance.reshape(len(FREQUENCY_HZ), -1), swapped.reshape(len(FREQUENCY_HZ), -1), 1e-9)


@pytest.mark.parametrize("name", ["reference-a", "reference-d"])
def test_slow_motion_of_one_of_two_bases_tilts_the_bar_straight_about_the_other(name: str) -> None:
    """Two springs are statically determinate: as omega -> 0 the bar follows each base, unbent."""
    device = shipped(name)
    plant = assemble(device)
    left, right = device.actuators
    found = solve_response(plant, np.array([1e-3])).displacement_m[0, :, 0::2]
    along = (plant.node_m - left.position_m) / (right.position_m - left.position_m)
    assert found[0] == pytest.approx(left.full_scale_m * (1 - along), abs=1e-6 * left.full_scale_m)
    assert found[1] == pytest.approx(right.full_scale_m * along, abs=1e-6 * right.full_scale_m)


@any_device
def test_slow_response_is_the_static_deflection(device: Device) -> None:
    plant = assemble(device)
    force = np.zeros((plant.size, len(device.actuators)))
    for i, (dof, actuator) in enumerate(zip(plant.actuator_dof, device.actuators, strict=True)):
        force[dof, i] = actuator.stiffness_n_per_m * actuator.full_scale_m
    static = np.linalg.solve(dense(plant.K), force).T
    assert_close(solve_response(plant, np.array([1e-3])).displacement_m[0], static.astype(complex), 1e-6)


@any_device
def test_all_bases_moving_slowly_together_carry_the_bar_along(device: Device) -> None:
    plant = assemble(with_actuators(device, full_scale_m=1e-6))
    carried = solve_response(plant, np.array([1e-3])).displacement_m[0].sum(axis=0)
    assert carried[0::2] == pytest.approx(np.full(len(plant.node_m), 1e-6), rel=1e-5)


@any_device
def test_power_in_is_power_dissipated(device: Device) -> None:
    """Mean power of the bases = that of the actuators' dampers, the bar's material and the fingers, for any drive."""
    fingers = np.array([0.21, 0.6]) * device.bar.length_m
    plant = assemble(device).with_fingers(fingers.tolist(), device.finger)
    random = np.random.default_rng(5)
    shape = (len(FREQUENCY_HZ), len(device.actuators))
    drive = random.normal(size=shape) + 1j * random.normal(size=shape)
    base = drive * [actuator.full_scale_m for actuator in device.actuators]
    omega = 2 * np.pi * FREQUENCY_HZ
    field = np.einsum("fad,fa->fd", solve_response(plant, FREQUENCY_HZ).displacement_m, drive)
    stretch = base - field[:, plant.actuator_dof]
    k, c = np.array([(a.stiffness_n_per_m, a.damping_n_s_per_m) for a in device.actuators]).T
    force = (k + 1j * omega[:, None] * c) * stretch
    power_in = (force * (1j * omega[:, None] * base).conj()).real.sum(axis=1) / 2
    C_bar = dense(plant.C)
    C_bar[plant.actuator_dof, plant.actuator_dof] -= c
    in_bar = np.einsum("fi,ij,fj->f", field.conj(), C_bar, field).real
    dissipated = omega**2 / 2 * (in_bar + (c * np.abs(stretch) ** 2).sum(axis=1))
    assert (power_in > 0).all()
    assert power_in == pytest.approx(dissipated, rel=1e-7)


@any_device
def test_assembled_fingers_equal_the_low_rank_update_of_the_receptance(device: Device) -> None:
    """Woodbury: G' = G - H_t (Z^-1 + H_tt)^-1 G_t with Z the fingers' dynamic stiffness (docs/theory.md#fingers)."""
    free = assemble(device)
    places = [f * device.bar.length_m for f in (0.0, 0.1234, 0.51, 0.93)]
    fingers = [replace(device.finger, stiffness_n_per_m=k, mass_kg=m) for k, m in ((300, 0), (1e3, 1e-4), (3e3, 3e-4))]
    fingers.append(device.finger)
    touched = solve_response(free.with_fingers(places, fingers), FREQUENCY_HZ).displacement_m
    untouched = solve_response(free, FREQUENCY_HZ).displacement_m
    sampler = free.sampler(np.array(places))
    touch = np.zeros((free.size, len(places)))
    for i, (element, weight) in enumerate(zip(sampler.element, sampler.weight, strict=True)):
        touch[2 * element : 2 * element + 4, i] = weight
    for after, before, frequency_hz in zip(touched, untouched, FREQUENCY_HZ, strict=True):
        w = 2 * np.pi * frequency_hz
        Z = [f.stiffness_n_per_m + 1j * w * f.damping_n_s_per_m - w * w * f.mass_kg for f in fingers]
        H = np.linalg.solve(dynamic_stiffness(free, frequency_hz), touch)
        low_rank = H @ np.linalg.solve(np.diag(1 / np.array(Z)) + touch.T @ H, touch.T @ before.T)
        assert_close(after, before - low_rank.T, 1e-7)


@any_device
def test_no_finger_and_a_finger_of_nothing_change_nothing(device: Device) -> None:
    plant = assemble(device)
    nothing = replace(device.finger, mass_kg=0.0, damping_n_s_per_m=0.0, stiffness_n_per_m=0.0)
    for same in (plant.with_fingers([], device.finger), plant.with_fingers([0.05], nothing)):
        assert (same.K == plant.K).all() and (same.C == plant.C).all() and (same.M == plant.M).all()


@any_device
def test_an_immensely_stiff_actuator_carries_its_place_along_whatever_touches_it(device: Device) -> None:
    held = with_actuators(device, stiffness_n_per_m=1e9)
    places = [actuator.position_m for actuator in held.actuators]
    plant = assemble(held).with_fingers(places, held.finger)
    at_actuators = solve_response(plant, FREQUENCY_HZ[:4]).displacement_m[:, :, plant.actuator_dof]
    expected = np.diag([actuator.full_scale_m for actuator in held.actuators]).astype(complex)
    assert_close(at_actuators, np.broadcast_to(expected, at_actuators.shape), 1e-3)


@any_device
def test_acceleration_is_minus_omega_squared_times_displacement(device: Device) -> None:
    response = solve_response(assemble(device), FREQUENCY_HZ)
    found = response.acceleration(response.plant.node_m)
    assert found.shape == (len(FREQUENCY_HZ), len(device.actuators), len(response.plant.node_m))
    omega = 2 * np.pi * FREQUENCY_HZ[:, None, None]
    assert_close(found, -(omega**2) * response.displacement_m[:, :, 0::2], 1e-12)


@any_device
def test_extra_nodes_do_not_change_the_field(device: Device) -> None:
    position_m = np.linspace(0.0, device.bar.length_m, 101)
    coarse = solve_response(assemble(device), FREQUENCY_HZ[:7]).acceleration(position_m)
    fine = solve_response(assemble(device, position_m[1:-1].tolist()), FREQUENCY_HZ[:7]).acceleration(position_m)
    assert_close(fine, coarse, 0.02)


def fields(device: Device, frequency_hz: NDArray[np.float64]) -> tuple[Complex, Response]:
    """Displacements at 101 even places (frequency, actuator, place)."""
    response = solve_response(assemble(device), frequency_hz)
    position_m = np.linspace(0.0, device.bar.length_m, 101)
    return response.plant.sampler(position_m).sample(response.displacement_m), response


@any_device
def test_mirrored_device_gives_mirrored_fields_and_zones(device: Device) -> None:
    field, response = fields(device, FREQUENCY_HZ)
    turned, other = fields(mirrored(device), FREQUENCY_HZ)
    assert_close(turned[..., ::-1], field, 1e-6)
    (gram, _), (turned_gram, _) = compute_gram(response), compute_gram(other)
    assert np.abs(turned_gram[:, ::-1] - gram).max() <= 1e-6 * np.abs(gram).max()


def test_mirror_symmetric_device_answers_alike_from_both_ends() -> None:
    device = shipped("reference-a")
    left = device.actuators[0]
    right = replace(left, name="right", position_m=device.bar.length_m - left.position_m)
    field, response = fields(replace(device, actuators=(left, right)), FREQUENCY_HZ)
    assert_close(field[:, 1, ::-1], field[:, 0], 1e-7)
    gram, _ = compute_gram(response)
    assert gram[:, ::-1, 1, 1].real == pytest.approx(gram[:, :, 0, 0].real, rel=1e-6)


@any_device
def test_response_is_proportional_to_full_scale(device: Device) -> None:
    louder = replace(
        device, actuators=tuple(replace(a, full_scale_m=a.full_scale_m * i) for i, a in enumerate(device.actuators, 2))
    )
    factors = np.arange(2, 2 + len(device.actuators))[None, :, None]
    assert_close(fields(louder, FREQUENCY_HZ)[0], fields(device, FREQUENCY_HZ)[0] * factors, 1e-9)


@any_device
@pytest.mark.parametrize(
    ("length", "stiffness", "time"),
    [(3.0, 1.0, 1.0), (1.0, 7.0, 1.0), (1.0, 1.0, 0.5), (0.4, 0.3, 2.0)],
    ids=["length", "stiffness and mass", "time", "all"],
)
def test_similar_devices_move_alike_at_similar_frequencies(
    device: Device, length: float, stiffness: float, time: float
) -> None:
    """Scaling law: lengths, stiffnesses and times by any factors leave displacement per base displacement as it is."""
    field, response = fields(device, FREQUENCY_HZ)
    similar, other = fields(scaled(device, length=length, stiffness=stiffness, time=time), FREQUENCY_HZ / time)
    assert_close(similar, field, 1e-6)
    expected = compute_gram(response)[1] * length / time**2  # velocity^2 times length
    assert np.abs(compute_gram(other)[1] - expected).max() <= 1e-6 * np.abs(expected).max()


@any_device
def test_twice_as_wide_is_twice_as_stiff_and_heavy(device: Device) -> None:
    wide = with_bar(device, width_m=2 * device.bar.width_m)
    doubled = replace(
        wide,
        actuators=tuple(
            replace(
                a,
                stiffness_n_per_m=2 * a.stiffness_n_per_m,
                damping_n_s_per_m=2 * a.damping_n_s_per_m,
                mass_kg=2 * a.mass_kg,
            )
            for a in device.actuators
        ),
    )
    assert_close(fields(doubled, FREQUENCY_HZ)[0], fields(device, FREQUENCY_HZ)[0], 1e-9)


@pytest.mark.parametrize("actuators", [1, 3, 5])
def test_any_number_of_actuators_and_one_more_changes_no_others_shape(actuators: int) -> None:
    device = random_device(seed=40 + actuators, actuators=actuators)
    displacement = solve_response(assemble(device), FREQUENCY_HZ).displacement_m
    assert displacement.shape == (len(FREQUENCY_HZ), actuators, assemble(device).size)
    assert np.isfinite(displacement).all() and (np.abs(displacement).max(axis=2) > 0).all()
