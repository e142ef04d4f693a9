"""Laws of the damped modes: stable, fingers as if assembled; test_transient.py holds them to the dense model."""

import numpy as np
import pytest

from base.arrays import Array, Complex
from engine.device import Device
from engine.device.surface_description import CLICKS_TOP_HZ
from precompute.model.assembly import assemble
from precompute.model.modal import CONVERGED, ModalModel, Mode, compute_basis, compute_modal_model, compute_modes
from precompute.model.response import solve_response
from tests.precompute.devices import any_bar, random_device, shipped


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


DEVICE = shipped("reference-a")
POINTS_M = np.linspace(0.0, DEVICE.bar.length_m, 101)


def modes_of(up_to_hz: float) -> tuple[Mode, ...]:
    return compute_modes(DEVICE, POINTS_M, up_to_hz, ())


def test_frequency_and_damping_are_those_of_the_peak_of_the_response() -> None:
    """At f (1 +- zeta) the magnitude of a mode far from others is 1 / sqrt 2 of that at its peak."""
    mode = modes_of(1000.0)[0]  # 34 Hz; the next is at 122 Hz
    about_hz = mode.frequency_hz * (1 + mode.damping_ratio * np.array([-1.0, 0.0, 1.0]))
    low, peak, high = np.abs(solve_response(assemble(DEVICE), about_hz).displacement_m[:, 0, 0])
    assert [low / peak, high / peak] == pytest.approx([2**-0.5] * 2, rel=0.08)


def test_the_modes_rise_and_end_where_they_are_asked_to() -> None:
    found = [mode.frequency_hz for mode in modes_of(up_to_hz=300.0)]
    assert found == sorted(found) and found[-1] <= 300.0
    assert len(modes_of(up_to_hz=600.0)) > len(found)
