"""Laws of the damped modes: those of the dense model, stable, fingers as if assembled, rise times as brute force."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from numpy.typing import NDArray

from engine.device import Device, Finger
from precompute.assembly import assemble
from precompute.modal import ModalModel, compute_basis, compute_modal_model, compute_rise_time
from precompute.response import solve_response
from tests.precompute.dense_model import DenseModel
from tests.precompute.devices import every_device, random_device, shipped

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


def envelope(model: DenseModel, frequency_hz: Array, amplitude: Complex, place_m: float, time_s: Array) -> Array:
    """Acceleration amplitude from rest, tones started at t = 0; column 0 is the final value, for ever."""
    system, inverse = dense_system(model)
    size, row = len(model.K), model.rows([place_m])[0]
    step = scipy.linalg.expm(system * (time_s[1] - time_s[0]))
    total = np.zeros(len(time_s) + 1)
    for hz in np.unique(frequency_hz[amplitude != 0]):
        omega, weight = 2 * np.pi * hz, np.where(frequency_hz == hz, amplitude, 0)
        force = np.append(np.zeros(size), inverse @ ((model.spring + 1j * omega * model.damper) @ weight))
        steady = np.linalg.solve(1j * omega * np.eye(2 * size) - system, force)
        free = np.empty(len(time_s), dtype=np.complex128)
        state, look = steady, row @ system[size:]  # acceleration of what dies away
        for k in range(len(time_s)):
            free[k] = look @ state
            state = step @ state
        final = -(omega**2) * (row @ steady[:size])
        total += abs(np.append(final, final * np.exp(1j * omega * time_s) - free))
    return total


DRIVES = {
    "coherent": ((111.7, 111.7), (1.0, 0.09)),
    "one alone": ((141.2, 141.2), (0.0, 1.0)),
    "coherent, opposed": ((300.0, 300.0), (1.0, -0.16)),
    "two tones": ((208.4, 77.3), (0.2, 1.0)),
}


@pytest.mark.parametrize("device", [shipped("reference-a"), shipped("reference-d")], ids=lambda device: device.name)
@pytest.mark.parametrize("drive", DRIVES)
def test_t90_is_the_time_after_which_the_acceleration_stays_within_a_tenth(device: Device, drive: str) -> None:
    frequency_hz, amplitude = np.array(DRIVES[drive][0]), np.array(DRIVES[drive][1], dtype=np.complex128)
    places_m = np.array([0.03, 0.45, 0.92]) * device.bar.length_m
    rise_s = compute_rise_time(compute_modal_model(compute_basis(assemble(device))), frequency_hz, amplitude, places_m)
    time_s = np.arange(0, 3, 5e-4)
    for place_m, found_s in zip(places_m, rise_s, strict=True):
        final, *level = envelope(DenseModel(device), frequency_hz, amplitude, place_m, time_s)
        outside = np.flatnonzero(abs(np.array(level) - final) > 0.1 * final)
        assert found_s == pytest.approx(time_s[outside[-1] + 1], rel=0.02, abs=1e-3)


def test_rise_does_not_depend_on_the_level() -> None:
    model = compute_modal_model(compute_basis(assemble(shipped("reference-a"))))
    frequency_hz, places_m = np.array([111.7, 230.0]), np.array([0.01, 0.2])
    amplitude = np.array([0.5, 1j], dtype=np.complex128)
    one, other = (compute_rise_time(model, frequency_hz, drive, places_m) for drive in (amplitude, amplitude / 1000))
    assert one == pytest.approx(other)
