"""Laws of receptances by places: those of a dense model, symmetric, at even places over the whole bar."""

from dataclasses import replace

import numpy as np
import pytest

from engine.device import Device
from precompute.model.assembly import assemble
from precompute.sampling.places import PITCH_M, solve_place_receptances
from tests.precompute.dense_model import DenseModel
from tests.precompute.devices import every_device, shipped, with_bar

FREQUENCY_HZ = np.array([61.0, 148.3, 290.0])


@pytest.mark.parametrize("device", every_device().values(), ids=lambda device: device.name)
def test_receptances_are_those_of_a_dense_model(device: Device) -> None:
    table = solve_place_receptances(assemble(device), FREQUENCY_HZ)
    omega = 2 * np.pi * FREQUENCY_HZ
    model = DenseModel(device)
    drive = model.unit_acceleration(FREQUENCY_HZ, table.place_m).transpose(1, 2, 0) / -(omega**2)
    assert abs(table.drive - drive).max() < 1e-6 * abs(drive).max()
    rows = model.rows(table.place_m)
    for k, w in enumerate(omega):
        point = rows @ np.linalg.solve(model.K + 1j * w * model.C - w**2 * model.M, rows.T)
        assert abs(table.point[:, k] - point[np.triu_indices(len(point))]).max() < 1e-6 * abs(point).max()


def test_places_cover_the_bar_evenly_and_are_at_most_a_pitch_apart() -> None:
    for length_m in (0.012, 0.2794, 0.5):
        device = with_bar(shipped("reference-a"), length_m=length_m)
        device = with_bar(device, largest_element_m=min(5e-3, length_m / 4))
        table = solve_place_receptances(assemble(replace(device, actuators=(), zones=())), FREQUENCY_HZ[:1])
        assert table.place_m[0] == 0 and table.place_m[-1] == pytest.approx(length_m)
        assert len(table.place_m) >= 5 and table.pitch_m <= PITCH_M * (1 + 1e-9)
        assert np.diff(table.place_m) == pytest.approx(table.pitch_m)
