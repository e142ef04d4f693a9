"""Laws of the assembled plant: mesh, damping, fingers, natural frequencies at order 4; of the solver of bands."""

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import eigh
from scipy.optimize import brentq

from base.arrays import Array
from engine.device import Device, Zone
from engine.device.surface_description import CLICKS_TOP_HZ
from precompute.model.assembly import BANDWIDTH, assemble, assemble_bar, build_mesh, dense
from precompute.model.band_solver import solve_banded
from precompute.model.modal import compute_basis, compute_modal_model
from precompute.model.plant import Plant
from precompute.model.response import solve_response
from tests.precompute.devices import any_bar, any_device, damped_as_assembly, shipped, with_bar

places = st.floats(0.0, 1.0)
MODES = 60


@st.composite
def meshed(draw: st.DrawFn) -> Device:
    """A bar with one to five actuators, some zones, and a largest element: all anywhere."""
    device = with_bar(shipped("reference-a"), length_m=draw(st.floats(0.01, 2.0)))
    length_m = device.bar.length_m
    device = with_bar(device, largest_element_m=length_m * draw(st.floats(5e-3, 3.0)))
    at = draw(st.lists(places, min_size=1, max_size=5, unique=True))
    actuators = tuple(replace(device.actuators[0], position_m=min(p * length_m, length_m)) for p in at)
    edges = sorted(draw(st.sets(places, min_size=2, max_size=9)))
    zones = tuple(Zone(str(i), a * length_m, b * length_m) for i, (a, b) in enumerate(itertools.pairwise(edges)))
    return replace(device, actuators=actuators, zones=zones)


@given(meshed())
def test_mesh_has_a_node_at_every_place_no_element_longer_than_asked_and_no_node_too_many(device: Device) -> None:
    node_m, length_m = build_mesh(device), device.bar.length_m
    wanted = [0.0, length_m, *(actuator.position_m for actuator in device.actuators)]
    wanted += [edge for zone in device.zones for edge in (zone.start_m, zone.stop_m)]
    assert node_m[0] == 0.0 and node_m[-1] == length_m
    for place in wanted:  # places closer than 0.03 % of the bar may share a node
        assert np.abs(node_m - place).min() <= 3.01e-4 * length_m
    assert np.diff(node_m).max() <= device.bar.largest_element_m * (1 + 1e-8)
    assert np.diff(node_m).min() > 2.99e-4 * length_m
    assert len(node_m) <= len(wanted) + length_m / device.bar.largest_element_m + 1


@any_device
def test_damping_of_the_assembly_acts_on_springs_and_bolts_too(device: Device) -> None:
    bar, plant = device.bar, assemble_bar(damped_as_assembly(device))
    own = [actuator.damping_n_s_per_m for actuator in device.actuators]
    expected = bar.mass_damping_per_s * plant.M + bar.stiffness_damping_s * plant.K
    expected[-1, plant.actuator_dof] += own
    assert np.abs(plant.C - expected).max() <= 1e-13 * np.abs(expected).max()
    assert (plant.K == assemble_bar(device).K).all() and (plant.M == assemble_bar(device).M).all()


def _natural_omegas(elements: int, clamped: list[int], rigid: int) -> Array:
    """First three elastic modes of REF-A's bar, rad/s, without the degrees of freedom in `clamped`."""
    device = shipped("reference-a")
    even = with_bar(device, largest_element_m=device.bar.length_m / elements)
    free = assemble_bar(replace(even, actuators=(), zones=()))
    keep = np.delete(np.arange(free.size), clamped)
    squares = eigh(dense(free.K)[np.ix_(keep, keep)], dense(free.M)[np.ix_(keep, keep)], eigvals_only=True)
    omegas: Array = np.sqrt(squares[rigid : rigid + 3])
    return omegas


@pytest.mark.parametrize(
    ("characteristic", "first", "clamped", "rigid"),
    [
        (lambda x: np.cos(x) - 1 / np.cosh(x), 1.5, [], 2),
        (np.sin, 1.0, [0, -2], 0),
        (lambda x: np.cos(x) + 1 / np.cosh(x), 0.5, [0, 1], 0),
    ],
    ids=["free-free", "pinned-pinned", "cantilever"],
)
def test_natural_frequencies_converge_at_order_four_to_the_closed_forms(
    characteristic: Callable[[float], float], first: float, clamped: list[int], rigid: int
) -> None:
    bar = shipped("reference-a").bar
    wavenumbers = [brentq(characteristic, (first + n - 0.2) * np.pi, (first + n + 0.2) * np.pi) for n in range(3)]
    speed = np.sqrt(bar.youngs_modulus_pa / bar.density_kg_per_m3 / 12) * bar.thickness_m  # sqrt(EI / rho A)
    exact = (np.array(wavenumbers) / bar.length_m) ** 2 * speed
    coarse, fine = (_natural_omegas(elements, clamped, rigid) / exact - 1 for elements in (14, 28))
    assert (fine > 0).all(), "a conforming element with consistent mass is too stiff, never too soft"
    assert (fine < 2e-5).all()
    order = np.log2(coarse / fine)
    assert ((order > 3.8) & (order < 4.2)).all(), order


@any_device
def test_sampler_reads_any_cubic_anywhere_on_the_bar(device: Device) -> None:
    plant, length_m = assemble_bar(device), device.bar.length_m
    cubic = np.polynomial.Polynomial([1.0, -2.0, 0.5, 3.0], [0, length_m], [0, 1])
    field = np.column_stack([cubic(plant.node_m), cubic.deriv()(plant.node_m)]).ravel() * (1 + 2j)
    position_m = np.concatenate([np.linspace(0.0, length_m, 101), plant.node_m])
    assert plant.sampler(position_m).sample(field) == pytest.approx(cubic(position_m) * (1 + 2j), abs=1e-12)


@any_device
def test_fingers_add_the_work_of_springs_dampers_and_masses_at_their_places(device: Device) -> None:
    plant, length_m = assemble_bar(device), device.bar.length_m
    position_m = [0.0, 0.317 * length_m, 0.318 * length_m, length_m]
    fingers = [replace(device.finger, stiffness_n_per_m=k) for k in (100.0, 200.0, 400.0, 800.0)]
    untouched = [matrix.copy() for matrix in (plant.K, plant.C, plant.M)]
    touched = plant.with_fingers(position_m, fingers)
    assert all((a == b).all() for a, b in zip(untouched, (plant.K, plant.C, plant.M), strict=True))
    field = np.random.default_rng(1).normal(size=plant.size) * np.tile([1.0, 50.0], plant.size // 2)
    at = plant.sampler(np.array(position_m)).sample(field.astype(complex)).real
    pairs = ((touched.K, plant.K, "stiffness_n_per_m"), (touched.C, plant.C, "damping_n_s_per_m"))
    for after, before, value in (*pairs, (touched.M, plant.M, "mass_kg")):
        work = sum(getattr(finger, value) * y * y for finger, y in zip(fingers, at, strict=True))
        assert field @ (dense(after) - dense(before)) @ field == pytest.approx(work, rel=1e-6)


def refined(device: Device, times: int) -> Plant:
    return assemble(with_bar(device, largest_element_m=device.bar.largest_element_m / times))


def frequencies(device: Device, start_hz: float, stop_hz: float) -> Array:
    """An even grid with seven frequencies about each resonance: the flanks, where a shift shows most, and the top."""
    pole = compute_modal_model(compute_basis(refined(device, 4), MODES)).pole
    pole = pole[(pole.imag > 0) & (pole.imag < 2 * np.pi * stop_hz)]
    about = (pole.imag[:, None] - pole.real[:, None] * np.array([-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0])) / (2 * np.pi)
    hz = np.unique(np.concatenate([np.linspace(start_hz, stop_hz, 241), about.ravel()]))
    inside: Array = hz[(hz >= start_hz) & (hz <= stop_hz)]
    return inside


def error(device: Device, frequency_hz: Array) -> Array:
    """Greatest distance (frequency, actuator) along the bar from a mesh four times finer."""
    places_m = np.linspace(0.0, device.bar.length_m, 41)
    own, fine = (solve_response(refined(device, n), frequency_hz).acceleration(places_m) for n in (1, 4))
    distance: Array = abs(own - fine).max(axis=2) / abs(fine).max(axis=2)
    return distance


@any_bar
def test_responses_are_right_to_a_twentieth_of_a_percent_at_resonances_and_in_the_band_of_clicks_too(
    device: Device,
) -> None:
    for stop_hz in (device.sweep.stop_hz, CLICKS_TOP_HZ):
        assert error(device, frequencies(device, device.sweep.start_hz, stop_hz)).max() < 5e-4


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
