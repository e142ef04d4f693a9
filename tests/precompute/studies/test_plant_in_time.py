"""Laws of the plant in time: it is the exact one of the rig, and its fingers are what they are made of."""

import numpy as np
import pytest

from base.arrays import Array
from engine.device import Device
from precompute.model.assembly import assemble
from precompute.model.modal import Basis, compute_basis
from precompute.model.transient import TransientPlant
from precompute.studies import plant_in_time
from precompute.studies.plant_in_time import accelerations, fill_accelerations
from precompute.studies.robustness import MOST_MODES, RATE_HZ, TOP_HZ
from tests.precompute.devices import any_device, damped_as_assembly, shipped, with_inertial

STEPS = 1200
NO_NODES = np.zeros((1, 2, 0, 5))


def places_on(device: Device) -> Array:
    corner_m = device.surface.corner_m
    return np.array([0.16 * corner_m, 0.62 * corner_m])


def plain_finger(device: Device) -> tuple[float, float, float]:
    finger = device.finger
    return finger.stiffness_n_per_m, finger.damping_n_s_per_m, finger.mass_kg


def burst(device: Device) -> Array:
    """Commands (actuator, time): 160 Hz under a window of 30 ms, straight between 4 kHz samples."""
    at_s, time_s = np.arange(121) / 4000, np.arange(STEPS) / RATE_HZ
    wave = np.sin(np.pi * at_s / 0.03) * np.sin(2 * np.pi * 160 * at_s)
    wave[-1] = 0.0
    return np.array([np.interp(time_s, at_s, (-0.7) ** k * wave) for k in range(len(device.actuators))])


def played(basis: Basis, grounded: tuple[float, ...], nodes: Array = NO_NODES, steps: int = STEPS) -> Array:
    """Accelerations (finger, time) under two fingers of the same kind."""
    device = basis.plant.device
    spring, damper = np.array([(each.spring_force_n, each.damper_force_n_s) for each in device.actuators]).T[:, :, None]
    moved = burst(device)[:, :steps]
    force_n = (spring * moved + damper * np.gradient(moved, 1 / RATE_HZ, axis=1))[None, None]
    shape = basis.at(places_on(device))[None]
    found = accelerations(basis, shape, np.broadcast_to(grounded, (1, 2, 3)), nodes, force_n, RATE_HZ)
    under: Array = found[0, 0]
    return under


@any_device
def test_it_moves_as_the_exact_plant_of_the_rig_does(device: Device) -> None:
    for each in (device, damped_as_assembly(device), with_inertial(device)):
        basis = compute_basis(assemble(each))
        exact = TransientPlant(basis, places_on(each), RATE_HZ)
        exact.touch([(at_m, each.finger) for at_m in places_on(each).tolist()])
        expected = exact.accelerate(burst(each).T).T
        found = played(basis, plain_finger(each))
        # A force jumps at the corners of a command, and the acceleration with it: half a step of doubt there.
        assert abs(found - expected).max() <= 5e-3 * abs(expected).max()


def test_the_modes_that_a_study_leaves_out_of_a_plate_hardly_move_it() -> None:
    basis = compute_basis(assemble(shipped("reference-p")), MOST_MODES)
    finger = plain_finger(basis.plant.device)
    every, kept = played(basis, finger), basis.lowest(int(np.sum(basis.square_omega < (2 * np.pi * TOP_HZ) ** 2)))
    assert 60 < len(kept.square_omega) < 120
    assert abs(played(kept, finger) - every).max() <= 1e-3 * abs(every).max()


def test_a_node_that_does_not_move_is_the_ground_and_one_that_nothing_holds_is_no_finger() -> None:
    basis = compute_basis(assemble(shipped("reference-d")))
    k, c, m = plain_finger(basis.plant.device)

    def behind(mass_kg: float) -> Array:
        return np.broadcast_to((k, c, 0.0, 0.0, mass_kg), (1, 2, 1, 5))

    expected, free = played(basis, (k, c, m)), played(basis, (0.0, 0.0, 0.0))
    assert played(basis, (0.0, 0.0, m), behind(1e3)) == pytest.approx(expected, abs=1e-5 * float(abs(expected).max()))
    light = played(basis, (0.0, 0.0, 0.0), behind(1e-7))
    assert light == pytest.approx(free, abs=2e-3 * float(abs(free).max()))
    assert abs(free - expected).max() > 0.05 * abs(free).max(), "the finger is felt by the bar"


def test_the_kernel_is_its_python_twin(monkeypatch: pytest.MonkeyPatch) -> None:
    basis = compute_basis(assemble(shipped("reference-a")))
    found = played(basis, plain_finger(basis.plant.device), steps=60)
    monkeypatch.setattr(plant_in_time, "fill_accelerations", fill_accelerations.py_func)
    assert found == pytest.approx(played(basis, plain_finger(basis.plant.device), steps=60), rel=1e-9, abs=1e-12)
