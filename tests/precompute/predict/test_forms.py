"""Laws of the forms: fingers as if assembled, Hermitian, semi-definite, energies and powers of the dense model."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from engine.device import Device
from precompute.model.assembly import Plant, assemble
from precompute.model.response import solve_response
from precompute.predict.forms import Forms, _fill_loaded, compute_forms, compute_loaded
from precompute.sampling.fingers import sample_fingers
from precompute.sampling.receptance import Receptance, solve_receptance
from tests.precompute.dense_model import DenseModel
from tests.precompute.devices import every_device, on_each, random_device, shipped, unhurried, with_bar
from tests.precompute.predict.dense_state import fingers_of, threshold
from tests.quick import first_quick

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
FREQUENCY_HZ = np.array([60.0, 112.0, 140.0, 179.35, 208.57, 230.0, 300.0])
DEVICES = every_device()
any_device = on_each(DEVICES)
touched_sets = pytest.mark.parametrize("touched", first_quick([(1, 3), (0,), (0, 1, 2, 3)]), ids=str)


@cache
def receptance_of(device: Device) -> Receptance:
    return solve_receptance(assemble(device), sample_fingers(device), FREQUENCY_HZ)


@cache
def forms_of(device: Device, touched: tuple[int, ...]) -> Forms:
    return compute_forms(receptance_of(device), touched)


def assembled(plant: Plant, touched: tuple[int, ...], case: int) -> Complex:
    """Displacement (frequency, finger, actuator) under the fingers of one case, assembled into the matrices."""
    places, fingers = zip(*fingers_of(sample_fingers(plant.device), case, touched), strict=True)
    loaded = plant.with_fingers(places, fingers)
    return loaded.sampler(np.array(places)).sample(solve_response(loaded, FREQUENCY_HZ).displacement_m).swapaxes(1, 2)


def update_error(device: Device, touched: tuple[int, ...]) -> Array:
    """Of the low-rank update against assembling, (frequency,), beside the greatest displacement; every eighth touch."""
    plant, found = assemble(device), compute_loaded(receptance_of(device), touched)
    errors = []
    for case in range(0, found.shape[1], 8):
        expected = assembled(plant, touched, case)
        errors.append(abs(found[:, case] - expected).max(axis=(1, 2)) / abs(expected).max(axis=(1, 2)))
    worst: Array = np.max(errors, axis=0)
    return worst


@touched_sets
@pytest.mark.parametrize("name", first_quick(["reference-a", "reference-d"]))
def test_the_low_rank_update_equals_assembling_the_fingers(name: str, touched: tuple[int, ...]) -> None:
    """With elements of 20 mm, since their number to the fourth power is what rounding grows with."""
    assert update_error(with_bar(shipped(name), largest_element_m=0.02), touched).max() <= 1e-10


@on_each(DEVICES | {f"random-{seed}": random_device(seed) for seed in (1, 3)})
def test_the_low_rank_update_equals_assembling_as_far_as_the_condition_allows(device: Device) -> None:
    """Elements are up to 1e7 times stiffer than the bar as a whole: both ways round, and differ by as much."""
    model = DenseModel(device)
    for error, hz in zip(update_error(device, (0, 1, 2, 3)), FREQUENCY_HZ, strict=True):
        omega = 2 * np.pi * hz
        stiffness = model.K + 1j * omega * model.C - omega**2 * model.M
        scale = 1 / np.sqrt(abs(np.diagonal(stiffness)))
        assert error <= 6 * np.finfo(float).eps * np.linalg.cond(scale[:, None] * stiffness * scale)


def random_complex(random: np.random.Generator, *shape: int) -> Complex:
    values: Complex = random.normal(size=shape) + 1j * random.normal(size=shape)
    return values


@unhurried
@given(st.integers(0, 2**32 - 1), st.integers(1, 3), st.integers(1, 4), st.integers(1, 5), st.integers(1, 3))
def test_the_kernel_solves_one_plus_receptance_times_stiffness(
    seed: int, frequencies: int, cases: int, fingers: int, actuators: int
) -> None:
    random, places = np.random.default_rng(seed), 7
    drive = random_complex(random, frequencies, places, actuators)
    point = random_complex(random, frequencies, places, places)
    place = random.integers(places, size=(cases, fingers))
    stiffness = random_complex(random, frequencies, cases, fingers)
    out = np.empty((frequencies, cases, fingers, actuators), dtype=np.complex128)
    _fill_loaded(drive, point, place, stiffness, out)
    for f in range(frequencies):
        for k in range(cases):
            at = place[k]
            matrix = np.eye(fingers) + point[f][np.ix_(at, at)] * stiffness[f, k]
            error = abs(matrix @ out[f, k] - drive[f, at]).max()
            assert error <= 1e-11 * (abs(matrix).max() * abs(out[f, k]).max() + abs(drive).max()) * fingers


def stacks_of(forms: Forms) -> dict[str, Complex]:
    """Every set of forms, (form, frequency, actuator, actuator)."""
    named = {name: getattr(forms, name) for name in ("level", "expected", "energy", "untouched_energy")}
    return {
        **named,
        "total": forms.total[None],
        "bar_mean": forms.bar_mean[None],
        "untouched_total": forms.untouched_total[None],
    }


@any_device
@touched_sets
def test_forms_are_hermitian_and_positive_semi_definite(device: Device, touched: tuple[int, ...]) -> None:
    for name, stack in stacks_of(forms_of(device, touched)).items():
        scale = abs(stack).max(axis=(2, 3))
        assert (abs(stack - stack.conj().swapaxes(2, 3)).max(axis=(2, 3)) <= 1e-13 * scale).all(), name
        assert (np.linalg.eigvalsh(stack)[..., 0] >= -1e-12 * scale).all(), name


def unit_weight(hz: float) -> float:
    """Power over threshold of a displacement of 1 m."""
    return float(((2 * np.pi * hz) ** 2 / threshold(hz)) ** 2)


@any_device
@pytest.mark.parametrize("touched", [(1, 3), (0, 1, 2, 3)], ids=str)
def test_powers_under_fingers_are_those_of_the_dense_model(device: Device, touched: tuple[int, ...]) -> None:
    """`level` of the standard case, `expected` averaged over the others: each case a model of its own."""
    forms, sampled, bare = forms_of(device, touched), sample_fingers(device), DenseModel(device)
    power = []
    for case in range(len(sampled.place)):
        fingers = fingers_of(sampled, case, touched)
        model = bare.touched(fingers)
        under = model.unit_acceleration(FREQUENCY_HZ, np.array([at for at, _ in fingers]))
        power.append(np.einsum("fpa,fpb->pfab", under.conj(), under))
    weight = np.array([threshold(hz) ** -2 for hz in FREQUENCY_HZ])[:, None, None]
    assert_forms(forms.level, power[0] * weight, 1e-6)
    assert_forms(forms.expected, np.mean(power[1:], axis=0) * weight, 1e-6)


def assert_forms(found: Complex, expected: Complex, relative: float) -> None:
    """Within `relative` of the greatest entry of each matrix."""
    assert (abs(found - expected).max(axis=(-2, -1)) <= relative * abs(expected).max(axis=(-2, -1))).all()


@any_device
@touched_sets
def test_energies_and_the_mean_power_of_the_bar_are_those_of_the_dense_model(
    device: Device, touched: tuple[int, ...]
) -> None:
    forms, fingers = forms_of(device, touched), fingers_of(sample_fingers(device), 0, touched)
    model = DenseModel(device, fingers)
    velocity = model.unit_field(FREQUENCY_HZ) / (2 * np.pi * FREQUENCY_HZ[:, None, None])
    whole = model.square_integral(0.0, device.bar.length_m)
    assert_forms(forms.total, velocity.conj().swapaxes(1, 2) @ whole @ velocity, 1e-6)
    for z, zone in enumerate(device.zones):
        part = model.square_integral(zone.start_m, zone.stop_m)
        energy = velocity.conj().swapaxes(1, 2) @ part @ velocity
        assert_forms(forms.energy[z], energy, 1e-6)
    # Mean over the bar of |y|^2 with y = v / omega, as a power over threshold.
    weight = np.array([unit_weight(hz) / (2 * np.pi * hz) ** 2 for hz in FREQUENCY_HZ])[:, None, None]
    total = velocity.conj().swapaxes(1, 2) @ whole @ velocity
    assert_forms(forms.bar_mean, total * weight / device.bar.length_m, 1e-6)


@any_device
def test_no_finger_leaves_the_bar_alone(device: Device) -> None:
    forms, receptance = forms_of(device, ()), receptance_of(device)
    count = len(device.actuators)
    assert len(forms.level) == len(forms.expected) == 0
    assert (forms.total == receptance.total_gram[:, :count, :count]).all()
    assert (forms.energy.swapaxes(0, 1) == receptance.zone_gram[:, :, :count, :count]).all()
    touched = forms_of(device, (0, 2))
    assert (touched.untouched_energy == forms.energy).all() and (touched.untouched_total == forms.total).all()


@any_device
def test_the_order_of_the_fingers_does_not_matter(device: Device) -> None:
    one, other = forms_of(device, (0, 2)), forms_of(device, (2, 0))
    assert_forms(other.level[::-1], one.level, 1e-9)
    assert_forms(other.total, one.total, 1e-9)


def test_a_finger_of_nothing_leaves_the_bar_alone() -> None:
    base = shipped("reference-a")
    nothing = replace(base.finger, mass_kg=0.0, damping_n_s_per_m=0.0, stiffness_n_per_m=0.0)
    device = replace(base, finger=nothing)
    assert_forms(forms_of(device, (0, 3)).total, forms_of(device, ()).total, 1e-12)


def test_bands_say_where_each_actuator_may_be_driven() -> None:
    base = shipped("reference-a")
    left, right = base.actuators
    device = replace(base, actuators=(replace(left, band_hz=(112.0, 230.0)), replace(right, band_hz=(60.0, 179.0))))
    assert forms_of(device, (0,)).in_band.T.tolist() == [
        [False, True, True, True, True, True, False],
        [True, True, True, False, False, False, False],
    ]
