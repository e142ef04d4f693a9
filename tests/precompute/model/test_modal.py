"""Laws of the damped modes: those of the dense model, stable, fingers as if assembled."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from engine.device import Device, Finger
from precompute.model.assembly import assemble
from precompute.model.modal import ModalModel, compute_basis, compute_modal_model
from precompute.model.response import solve_response
from tests.precompute.dense_model import DenseModel
from tests.precompute.devices import every_device, random_device

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
DEVICES = every_device()
any_device = pytest.mark.parametrize("device", DEVICES.values(), ids=DEVICES)


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


@any_device
def test_fingers_in_the_modes_are_fingers_in_the_matrices(device: Device) -> None:
    plant, (places, fingers) = assemble(device), zip(*fingers_on(device), strict=True)
    model = compute_modal_model(compute_basis(plant), fingers_on(device))
    position_m = np.linspace(0, device.bar.length_m, 22)
    response = solve_response(plant.with_fingers(places, fingers), np.linspace(60, 300, 17))
    for hz, expected in zip(response.frequency_hz, response.acceleration(position_m), strict=True):
        assert abs(steady_acceleration(model, hz, position_m) - expected.T).max() <= 1e-3 * abs(expected).max()


@pytest.mark.parametrize("actuators", [1, 2, 3])
@pytest.mark.parametrize("seed", [2, 5, 29])
def test_no_mode_grows(seed: int, actuators: int) -> None:
    """One actuator alone lets the bar turn about it: a mode of frequency 0, which rounding must not make unstable."""
    model = compute_modal_model(compute_basis(assemble(random_device(seed, actuators))))
    assert model.pole.real.max() <= 1e-4
