"""Laws of the damped modes: those of the dense model, stable, fingers as if assembled."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from engine.device import Device, Finger
from engine.device.file import CLICKS_TOP_HZ
from precompute.model.assembly import assemble
from precompute.model.modal import CONVERGED, ModalModel, compute_basis, compute_modal_model, truncation_errors
from precompute.model.response import solve_response
from tests.precompute.dense_model import DenseModel
from tests.precompute.devices import damped_as_assembly, every_device, on_each, other_bars, random_device, shipped
from tests.quick import first_quick

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
DEVICES = every_device()
any_device = on_each(DEVICES)


def fingers_on(device: Device) -> list[tuple[float, Finger]]:
    soft = replace(device.finger, damping_n_s_per_m=0.3, stiffness_n_per_m=300.0)
    return [(0.07 * device.bar.length_m, device.finger), (0.63 * device.bar.length_m, soft)]


def dense_system(model: DenseModel) -> tuple[Array, NDArray[np.floating]]:
    """State matrix and inverse mass of the dense model, state (displacement, velocity)."""
    size, inverse = len(model.K), np.linalg.inv(model.M)
    upper = np.hstack([np.zeros((size, size)), np.eye(size)])
    return np.vstack([upper, np.hstack([-inverse @ model.K, -inverse @ model.C])]), inverse


def steady_acceleration(model: ModalModel, frequency_hz: float, position_m: Array) -> Complex:
    """Shape (point, actuator) from the poles: -omega^2 times the displacement of exp(j omega t)."""
    omega = 2 * np.pi * frequency_hz
    shape = model.basis.at(position_m) @ model.vector[: len(model.push)]
    state = (model.spring + 1j * omega * model.damper) / (1j * omega - model.pole)[:, None]
    acceleration: Complex = -(omega**2) * shape @ state
    return acceleration


@any_device
@pytest.mark.parametrize("touched", [False, True])
def test_poles_below_500_hz_are_those_of_the_dense_model(device: Device, touched: bool) -> None:
    fingers = fingers_on(device) if touched else []
    poles = [
        compute_modal_model(compute_basis(assemble(device)), fingers).pole,
        np.linalg.eigvals(dense_system(DenseModel(device, fingers))[0]),
    ]
    low = [np.sort_complex(pole[(pole.imag > 0) & (abs(pole) < 2 * np.pi * 500)]) for pole in poles]
    assert low[0] == pytest.approx(low[1], rel=1e-4)


@any_device
@pytest.mark.parametrize("touched", [False, True])
def test_the_modes_answer_a_tone_as_the_dense_model_does(device: Device, touched: bool) -> None:
    fingers = fingers_on(device) if touched else []
    model, dense = compute_modal_model(compute_basis(assemble(device)), fingers), DenseModel(device, fingers)
    position_m = np.linspace(0, device.bar.length_m, 22)
    for hz in np.linspace(60, 300, 17):
        expected = dense.unit_acceleration(np.array([hz]), position_m)[0]
        assert abs(steady_acceleration(model, hz, position_m) - expected).max() <= 1e-3 * abs(expected).max()


@pytest.mark.parametrize("actuators", [1, 2, 3])
@pytest.mark.parametrize("seed", [2, 5, 29])
def test_no_mode_grows(seed: int, actuators: int) -> None:
    """One actuator alone lets the bar turn about it: a mode of frequency 0, which rounding must not make unstable."""
    model = compute_modal_model(compute_basis(assemble(random_device(seed, actuators))))
    assert model.pole.real.max() <= 1e-4


OTHERS = {name: shipped(name) for name in ("reference-a", "reference-d", "reference-t")} | other_bars()


def loaded_error(device: Device, modes: int | None, top_hz: float) -> float:
    """Greatest error of an acceleration under fingers in every zone, over its greatest value, with so many modes."""
    plant, hz = assemble(device), np.linspace(device.sweep.start_hz, top_hz, 150)
    middle_m = np.array([(zone.start_m + zone.stop_m) / 2 for zone in device.zones])
    fingers = [(at, device.finger) for at in middle_m.tolist()]
    model = compute_modal_model(compute_basis(plant, modes), fingers)
    found = np.array([steady_acceleration(model, f, middle_m).T for f in hz.tolist()])
    exact = solve_response(plant.with_fingers(middle_m.tolist(), device.finger), hz).acceleration(middle_m)
    return float((abs(found - exact).max(axis=0) / abs(exact).max(axis=0)).max())


@pytest.mark.parametrize("device", first_quick(OTHERS.values(), len(OTHERS) - 1), ids=OTHERS)
def test_as_many_modes_as_the_band_needs_leave_a_hundredth_of_a_decibel(device: Device) -> None:
    for top_hz in (device.sweep.stop_hz, CLICKS_TOP_HZ):
        assert loaded_error(device, None, top_hz) < 1.5 * CONVERGED  # at other frequencies than they were counted at


def test_truncation_errors_are_those_of_the_damped_modes() -> None:
    """The sums over modes with impedances attached, against eigenvalues of the state space, for both dampings."""
    for device in (DEVICES["reference-a"], damped_as_assembly(DEVICES["reference-a"])):
        plant, hz = assemble(device), np.linspace(60.0, 300.0, 150)
        basis = compute_basis(plant, 24)
        forced = truncation_errors(basis, hz)
        for modes, error in zip((8, 12, 16), forced[1:4].tolist(), strict=True):
            assert loaded_error(device, modes, 300.0) == pytest.approx(error, rel=0.01)
