"""Laws of the damped modes: stable, fingers as if assembled; test_transient.py holds them to the dense model."""

import numpy as np
import pytest

from base.arrays import Array, Complex
from engine.device import Device
from engine.device.surface_description import CLICKS_TOP_HZ
from precompute.model.assembly import assemble
from precompute.model.modal import CONVERGED, ModalModel, compute_basis, compute_modal_model
from precompute.model.response import solve_response
from tests.precompute.devices import any_bar, random_device


def steady_acceleration(model: ModalModel, frequency_hz: float, position_m: Array) -> Complex:
    """Shape (point, actuator) from the poles: -omega^2 times the displacement of exp(j omega t)."""
    omega = 2 * np.pi * frequency_hz
    shape = model.basis.at(position_m) @ model.vector[: len(model.push)]
    state = (model.spring + 1j * omega * model.damper) / (1j * omega - model.pole)[:, None]
    acceleration: Complex = -(omega**2) * shape @ state
    return acceleration


@pytest.mark.parametrize("actuators", [1, 2, 3])
@pytest.mark.parametrize("seed", [2, 5, 29])
def test_no_mode_grows(seed: int, actuators: int) -> None:
    """One actuator alone lets the bar turn about it: a mode of frequency 0, which rounding must not make unstable."""
    model = compute_modal_model(compute_basis(assemble(random_device(seed, actuators))))
    assert model.pole.real.max() <= 1e-4


def loaded_error(device: Device, top_hz: float) -> float:
    """Greatest error of an acceleration under fingers in every zone, over its greatest value."""
    plant, hz = assemble(device), np.linspace(device.sweep.start_hz, top_hz, 150)
    middle_m = np.array([(zone.start_m + zone.stop_m) / 2 for zone in device.zones])
    fingers = [(at, device.finger) for at in middle_m.tolist()]
    model = compute_modal_model(compute_basis(plant), fingers)
    found = np.array([steady_acceleration(model, f, middle_m).T for f in hz.tolist()])
    exact = solve_response(plant.with_fingers(middle_m.tolist(), device.finger), hz).acceleration(middle_m)
    return float((abs(found - exact).max(axis=0) / abs(exact).max(axis=0)).max())


@any_bar
def test_as_many_modes_as_the_band_needs_leave_a_hundredth_of_a_decibel(device: Device) -> None:
    for top_hz in (device.sweep.stop_hz, CLICKS_TOP_HZ):
        assert loaded_error(device, top_hz) < 1.5 * CONVERGED  # at other frequencies than they were counted at
