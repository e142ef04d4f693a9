"""Laws of the untouched bar's receptance: the dense model's at every place, reciprocal, frequency by frequency."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from engine.device import Device
from precompute.model.assembly import assemble
from precompute.sampling.fingers import PLACES, sample_fingers
from precompute.sampling.receptance import Receptance, solve_receptance
from tests.precompute.dense_model import DenseModel
from tests.precompute.devices import every_device, on_each

Complex = NDArray[np.complex128]
FREQUENCY_HZ = np.array([60.0, 112.0, 140.0, 179.35, 208.57, 230.0, 300.0])
DEVICES = every_device()
any_device = on_each(DEVICES)


@cache
def solved(device: Device) -> Receptance:
    return solve_receptance(assemble(device), sample_fingers(device), FREQUENCY_HZ)


def dense_columns(device: Device, frequency_hz: float, places_m: NDArray[np.float64]) -> tuple[Complex, Complex]:
    """Displacement (degree of freedom, column) by each actuator and by a unit force at each place, and rows there."""
    model, omega = DenseModel(device), 2 * np.pi * frequency_hz
    rows = model.rows(places_m)
    right = np.hstack([model.spring + 1j * omega * model.damper, rows.T])
    columns: Complex = np.linalg.solve(model.K + 1j * omega * model.C - omega**2 * model.M, right)
    return columns, rows @ columns


@any_device
def test_every_place_moves_as_in_the_dense_model(device: Device) -> None:
    found, actuators = solved(device), len(device.actuators)
    for f, hz in enumerate(FREQUENCY_HZ):
        _, expected = dense_columns(device, hz, found.sampled.position_m.ravel())
        drive, point = expected[:, :actuators], expected[:, actuators:]
        assert abs(found.drive[f] - drive).max() <= 1e-7 * abs(drive).max()
        assert abs(found.point[f] - point).max() <= 1e-7 * abs(point).max()


@any_device
def test_energies_are_those_of_actuators_and_of_forces_at_the_middles(device: Device) -> None:
    found, actuators, model = solved(device), len(device.actuators), DenseModel(device)
    kept = [*range(actuators), *(actuators + zone * PLACES + PLACES // 2 for zone in range(len(device.zones)))]
    spans = [(0.0, device.bar.length_m), *((zone.start_m, zone.stop_m) for zone in device.zones)]
    integrals = [model.square_integral(*span) for span in spans]
    for f, hz in enumerate(FREQUENCY_HZ):
        velocity = 2 * np.pi * hz * dense_columns(device, hz, found.sampled.position_m.ravel())[0][:, kept]
        total, *parts = [velocity.conj().T @ integral @ velocity for integral in integrals]
        # A metre of base and a newton of finger are worlds apart: each column is measured by its own energy.
        scale = np.sqrt(np.outer(*[np.diagonal(total).real] * 2))
        assert (abs(found.total_gram[f] - total) / scale).max() <= 1e-6
        assert (abs(found.zone_gram[f] - np.array(parts)) / scale).max() <= 1e-6


def test_many_frequencies_are_solved_as_each_alone() -> None:
    device = DEVICES["reference-a"]
    hz = np.linspace(60, 300, 131)  # more than two of the solver's stretches
    together = solve_receptance(assemble(device), sample_fingers(device), hz)
    for f in (0, 63, 64, 127, 128, 130):
        alone = solve_receptance(assemble(device), sample_fingers(device), hz[f : f + 1])
        for name in ("drive", "point", "zone_gram", "total_gram"):
            assert (getattr(alone, name)[0] == getattr(together, name)[f]).all()
