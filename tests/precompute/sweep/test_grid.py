"""Laws of the grid: points close enough, an honest interpolation error."""

import numpy as np
import pytest

from base.arrays import Array
from engine.device import Device
from precompute.model.assembly import assemble
from precompute.sweep.grid import compute_grid_response, estimate_interpolation_error, sampling_error, zone_points
from tests.precompute.dense_model import DenseModel
from tests.precompute.devices import every_device, on_each, random_device

DEVICES = every_device() | {f"random-{seed}": random_device(seed) for seed in (1, 2, 3)}
any_device = on_each(DEVICES)
FREQUENCY_HZ = np.linspace(60.0, 300.0, 25)


@any_device
def test_a_peak_on_the_points_is_within_the_sampling_error_of_one_on_twenty_times_as_many(device: Device) -> None:
    model, points_m = DenseModel(device), zone_points(device)
    frequency_hz = np.append(FREQUENCY_HZ, device.sweep.stop_hz)
    drives = np.array([[1, -1, 1j, 0.3], [0.2, 1, 1, 1j], [0, 0.1j, -1, 1]])[: len(device.actuators)]
    for row in points_m:
        fine_m = np.linspace(row[0], row[-1], 20 * (len(row) - 1) + 1)
        coarse, fine = (
            abs(model.unit_acceleration(frequency_hz, place_m) @ drives).max(axis=1) for place_m in (row, fine_m)
        )
        assert (coarse >= fine * (1 - sampling_error(device))).all()


def looked_at(device: Device, frequency_hz: Array) -> tuple[Array, Array]:
    """Localized factor and peak of each actuator alone, (frequency, actuator, zone), through the dense model."""
    model, points_m = DenseModel(device), zone_points(device)
    peak = np.stack([np.abs(model.unit_acceleration(frequency_hz, row)).max(axis=1) for row in points_m], axis=-1)
    energies = [model.unit_gram(frequency_hz, zone.start_m.real, zone.stop_m.real) for zone in device.zones]
    total = np.einsum("faa->fa", model.unit_gram(frequency_hz, 0.0, device.bar.length_m, 4001)).real
    return np.stack([np.einsum("faa->fa", e).real for e in energies], axis=-1) / total[..., None], peak


@any_device
def test_the_interpolation_error_is_that_of_a_direct_comparison(device: Device) -> None:
    frequency_hz = np.linspace(100.0, 220.0, 25)
    plant = assemble(device)
    found = estimate_interpolation_error(plant, compute_grid_response(plant, frequency_hz, zone_points(device)))
    factor, peak = looked_at(device, frequency_hz)
    factor_there, peak_there = looked_at(device, (frequency_hz[:-1] + frequency_hz[1:]) / 2)
    expected = abs((factor[:-1] + factor[1:]) / 2 - factor_there).max(axis=2)
    relative = abs(((peak[:-1] + peak[1:]) / 2 - peak_there) / peak_there).max(axis=2)
    for own, direct in zip(found, (expected, relative), strict=True):
        assert own == pytest.approx(direct, rel=1e-3, abs=1e-6)
