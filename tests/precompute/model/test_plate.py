"""Laws of the plate: published and independent solutions, a beam, convergence, reciprocity, power, clicks."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import scipy.linalg
import scipy.signal
from skfem import Basis, BilinearForm, ElementTriArgyris, MeshTri

from base.arrays import Array, even_points
from engine.device import Actuator, Device, Finger
from engine.device.parts import Plate
from engine.touch import Placement
from precompute.clicks.click_basis import RINGDOWN_S, SAMPLE_RATE_HZ
from precompute.clicks.evaluation import decibels
from precompute.model.assembly import assemble
from precompute.model.gram import compute_steady_state
from precompute.model.modal import compute_modes, seen_points
from precompute.model.modal_plant import ModalPlant
from precompute.model.plate import Ritz, degrees_of, plate_matrices
from precompute.model.response import solve_response
from precompute.model.transfers import threshold_filter
from tests.precompute.clicks.click_cases import solver_of
from tests.precompute.devices import shipped

TABLET = shipped("reference-p")
POINTS_M = np.array([0.04 + 0.03j, 0.1 + 0.06j, 0.21 + 0.11j, 0.29 + 0.17j])
HZ = np.array([60.0, 118.0, 187.0, 300.0])


@cache
def plant_of(device: Device) -> ModalPlant:
    plant = assemble(device)
    assert isinstance(plant, ModalPlant)
    return plant


def frequencies_hz(plate: Plate, degrees: tuple[int, int], actuators: tuple[Actuator, ...] = ()) -> Array:
    ritz = Ritz.of(plate, degrees)
    K, M = plate_matrices(plate, ritz.energies)
    if actuators:
        rows = ritz.at(np.array([actuator.position_m for actuator in actuators]))
        K = K + (rows.T * [actuator.stiffness_n_per_m for actuator in actuators]) @ rows
        M = M + (rows.T * [actuator.mass_kg for actuator in actuators]) @ rows
    square = scipy.linalg.eigh(K, M, eigvals_only=True)
    return np.sqrt(np.maximum(square, 0.0)) / (2 * np.pi)


def test_a_free_square_plate_has_the_published_frequencies() -> None:
    """Leissa, NASA SP-160, table 4.74: omega a^2 sqrt(rho h / D) for a Poisson's ratio of 0.3, after rigid ones."""
    assert isinstance(TABLET.surface, Plate)
    plate = replace(TABLET.surface, length_m=0.3, width_m=0.3, poissons_ratio=0.3)
    unit = 2 * np.pi * 0.3**2 * np.sqrt(plate.density_kg_per_m3 * plate.thickness_m / plate.bending_n_m)
    found = frequencies_hz(plate, (14, 14)) * unit
    assert found[:3] == pytest.approx(0, abs=1e-2)
    assert found[3:8] == pytest.approx([13.468, 19.596, 24.270, 34.801, 34.801], rel=1e-3)


def test_a_strip_without_poissons_ratio_has_the_modes_of_the_bar() -> None:
    """The strip also twists; actuators on its middle line do not move it so."""
    device = shipped("reference-a")
    bar, middle_m = device.bar, 0.5j * device.bar.width_m
    values = {key: value for key, value in vars(bar).items() if key != "largest_element_m"}
    strip = replace(
        device,
        surface=Plate(**values, poissons_ratio=0.0),
        actuators=tuple(replace(each, position_m=each.position_m + middle_m) for each in device.actuators),
        zones=tuple(replace(z, start_m=complex(z.start_m), stop_m=z.stop_m + 2 * middle_m) for z in device.zones),
    )
    assert isinstance(strip.surface, Plate)
    modes, expected = (compute_modes(each, seen_points(each)[:1], 1000.0) for each in (strip, device))
    assert len(expected) >= 6
    for mode in expected:
        near = min(modes, key=lambda other: abs(other.frequency_hz - mode.frequency_hz))  # used at once
        assert near.frequency_hz == pytest.approx(mode.frequency_hz, rel=2e-3)
        assert near.damping_ratio == pytest.approx(mode.damping_ratio, rel=0.02)


def test_with_more_functions_frequencies_fall_less_and_less() -> None:
    """Ritz's frequencies are upper bounds; with those that are used the ones in the band are converged."""
    plate = TABLET.surface
    assert isinstance(plate, Plate)
    used = degrees_of(plate, TABLET.sweep.stop_hz)
    few, many, more = (
        frequencies_hz(plate, degrees, TABLET.actuators)[:12]
        for degrees in ((12, 10), used, (used[0] + 12, used[1] + 12))
    )
    assert (few >= many * (1 - 1e-9)).all() and (many >= more * (1 - 1e-9)).all()
    assert (many - more).max() < 0.1 * (few - more).max()
    assert many == pytest.approx(more, rel=2e-3)


def test_what_a_point_gets_of_a_force_at_another_it_gives_back() -> None:
    plant = plant_of(TABLET).with_fingers([0.15 + 0.09j], TABLET.finger)
    response = solve_response(plant, HZ, POINTS_M)
    mutual = plant.sampler(POINTS_M).sample(response.displacement_m)[:, len(TABLET.actuators) :]
    assert mutual == pytest.approx(mutual.transpose(0, 2, 1), rel=1e-9, abs=1e-12 * abs(mutual).max())


def test_the_power_of_a_force_is_what_the_dampers_take() -> None:
    plant = plant_of(TABLET).with_fingers([0.15 + 0.09j], TABLET.finger)
    field = solve_response(plant, HZ, POINTS_M[:1]).displacement_m[:, -1]
    omega = 2 * np.pi * HZ
    moved = plant.sampler(POINTS_M[:1]).sample(field)[:, 0]
    put_in = 0.5 * (1j * omega * moved).real
    taken = 0.5 * omega**2 * np.einsum("fi,ij,fj->f", field.conj(), plant.C, field).real
    assert put_in == pytest.approx(taken, rel=1e-6)


def test_zones_share_what_the_whole_plate_has_and_a_zones_integral_is_that_of_its_points() -> None:
    plant = plant_of(replace(TABLET, zones=(*TABLET.zones[:2], *TABLET.zones[3:])))
    field = solve_response(plant, HZ).displacement_m
    gram, zones = plant.gram(field), plant.device.zones
    whole = np.einsum("fai,ij,fbj->fab", field.conj(), plant.integral_over(0j, TABLET.surface.corner_m), field)
    assert gram.sum(axis=1) == pytest.approx(whole, rel=1e-9, abs=1e-12 * abs(whole).max())
    missing = TABLET.zones[2]
    beside = np.einsum("fai,ij,fbj->fab", field.conj(), plant.integral_over(missing.start_m, missing.stop_m), field)
    assert gram[:, -1] == pytest.approx(beside, rel=1e-7, abs=1e-9 * abs(whole).max())
    node, weight = np.polynomial.legendre.leggauss(40)
    span_m = zones[1].stop_m - zones[1].start_m
    x_m, y_m = (0.5 * (1 + node) * side for side in (span_m.real, span_m.imag))
    seen = plant.sampler(zones[1].start_m + (x_m[:, None] + 1j * y_m).ravel()).sample(field)
    area = 0.25 * span_m.real * span_m.imag * np.outer(weight, weight).ravel()
    assert gram[:, 1] == pytest.approx(np.einsum("fap,p,fbp->fab", seen.conj(), area, seen), rel=1e-9, abs=1e-20)


def _bending(u: Any, v: Any, w: Any) -> Any:
    both = (u.hess[0, 0] + u.hess[1, 1]) * (v.hess[0, 0] + v.hess[1, 1])
    each = sum(u.hess[i, j] * v.hess[i, j] for i in range(2) for j in range(2))
    return w.nu * both + (1 - w.nu) * each


def _argyris(device: Device, beside_m: Any, parts: Sequence[Actuator | Finger] = ()) -> tuple[Any, Any, Any, Any]:
    """K, C and M of finite elements of degree five, and the degree of freedom at each actuator and point beside them.

    Every one of them is a node, and has the spring, damper and mass of `parts` in turn: actuators, then fingers.
    """
    plate = device.surface
    assert isinstance(plate, Plate)
    places_m = np.array([*(each.position_m for each in device.actuators), *beside_m])
    corner_m = plate.corner_m
    x_m, y_m = ([0.0, *side, end] for side, end in ((places_m.real, corner_m.real), (places_m.imag, corner_m.imag)))
    basis = Basis(MeshTri.init_tensor(np.unique(x_m), np.unique(y_m)), ElementTriArgyris(), intorder=8)
    K = plate.bending_n_m * BilinearForm(_bending).assemble(basis, nu=plate.poissons_ratio).toarray()
    M = plate.density_kg_per_m3 * plate.thickness_m * BilinearForm(lambda u, v, _: u * v).assemble(basis).toarray()
    C = plate.mass_damping_per_s * M + plate.stiffness_damping_s * K
    nodes_m = basis.mesh.p[0] + 1j * basis.mesh.p[1]
    dof = basis.nodal_dofs[0, abs(nodes_m[:, None] - places_m).argmin(axis=0)]
    for at, part in zip(dof, [*device.actuators, *parts], strict=False):
        K[at, at] += part.stiffness_n_per_m
        C[at, at] += part.damping_n_s_per_m
        M[at, at] += part.mass_kg
    return K, C, M, dof


def test_its_responses_are_those_of_argyris_elements() -> None:
    K, C, M, dof = _argyris(TABLET, POINTS_M[1:3])
    found = solve_response(plant_of(TABLET), HZ).acceleration(POINTS_M[1:3])
    for hz, moved in zip(HZ, found, strict=True):
        w = 2 * np.pi * hz
        force = np.zeros((len(K), 4), dtype=np.complex128)
        force[dof[:4], range(4)] = [
            (a.stiffness_n_per_m + 1j * w * a.damping_n_s_per_m) * a.full_scale_m for a in TABLET.actuators
        ]
        expected = -(w**2) * np.linalg.solve(K + 1j * w * C - w**2 * M, force)[dof[4:]].T
        assert abs(moved - expected).max() <= 0.02 * abs(expected).max()


def _played_by_argyris(device: Device, waveform: Array, fingers_m: Sequence[complex]) -> Array:
    """Levels (finger,) in dB of a click on finite elements in time, by Newmark's method of mean acceleration."""
    K, C, M, dof = _argyris(device, fingers_m, [device.finger] * len(fingers_m))
    driven, step_s = len(device.actuators), 1 / (12 * SAMPLE_RATE_HZ)
    stiffness, damping, scale = (
        np.array([getattr(each, key) for each in device.actuators])
        for key in ("stiffness_n_per_m", "damping_n_s_per_m", "full_scale_m")
    )
    at = np.arange((waveform.shape[1] - 1) * 12 + 1) / 12
    base = np.stack([np.interp(at, np.arange(waveform.shape[1]), each) for each in waveform], axis=1) * scale
    base = np.pad(base, ((0, round(RINGDOWN_S / step_s)), (0, 0)))
    force = stiffness * base + damping * np.gradient(base, step_s, axis=0)
    solved = np.linalg.inv(M + step_s / 2 * C + step_s**2 / 4 * K)
    u, v, a = np.zeros((3, len(K)))
    course = np.zeros((len(base), len(fingers_m)))
    for moment, here in zip(course[1:], force[1:], strict=True):
        u, v = u + step_s * v + step_s**2 / 4 * a, v + step_s / 2 * a
        pushed = -(K @ u) - C @ v
        pushed[dof[:driven]] += here
        a = solved @ pushed
        u, v = u + step_s**2 / 4 * a, v + step_s / 2 * a
        moment[:] = a[dof[driven:]]
    taps = threshold_filter(device.threshold, 1 / step_s)
    return decibels(abs(scipy.signal.fftconvolve(course, taps[:, None], axes=0)[: len(course)]).max(axis=0))


@pytest.mark.long
@pytest.mark.parametrize(
    "felt, quiet",
    [(["30 x 100 mm"], ["150 x 90 mm", "270 x 20 mm"]), (["150 x 90 mm", "90 x 170 mm"], ["240 x 60 mm"])],
)
def test_an_independent_plate_in_time_gives_what_a_click_promises(felt: list[str], quiet: list[str]) -> None:
    """Quiet fingers are 32 dB below felt ones, so that 0.2 dB of theirs is 0.5 per mille of what is felt."""
    click = solver_of("reference-p").solve(Placement.named(TABLET, felt, quiet))
    found_db = _played_by_argyris(TABLET, click.waveform.T, click.placement.position_m)
    promised_db = np.array([finger.level_db for finger in click.fingers])
    is_felt = np.array(click.placement.is_felt)
    assert promised_db[is_felt].min() - promised_db[~is_felt].max() > 20
    assert found_db[is_felt] == pytest.approx(promised_db[is_felt], abs=0.05)
    assert found_db == pytest.approx(promised_db, abs=0.2)


def test_a_peak_lies_where_no_other_point_of_its_zone_moves_more() -> None:
    plant, hz = plant_of(TABLET), np.full(4, 187.0)
    amplitude = np.array([1.0, 0.4j, -0.7, 0.2])
    state = compute_steady_state(plant, hz, amplitude)
    field = np.einsum("a,ap->p", amplitude, solve_response(plant, hz[:1]).displacement_m[0])
    for zone, peak, at_m in zip(TABLET.zones, state.peak, state.peak_position_m, strict=True):
        fine_m = even_points(zone.start_m, zone.stop_m, 101, 91)
        level = (2 * np.pi * 187.0) ** 2 * abs(plant.sampler(fine_m).sample(field))
        assert peak == pytest.approx(level.max(), rel=2e-3)
        assert abs(at_m - fine_m[level.argmax()]) < 3e-3
    assert state.share.sum() == pytest.approx(1.0)
