"""The device file of a placement is that placement and nothing else."""

from dataclasses import replace

import pytest

from base.points import point_at
from engine.device import Device
from precompute.studies.placement_search import placed_text, with_actuators_at
from tests.precompute.devices import shipped


@pytest.mark.parametrize("name", ["reference-a", "reference-d", "reference-t", "reference-p"])
@pytest.mark.parametrize("shares", [(0.5,), (0.91, 0.12), (0.05, 0.3, 0.6, 0.95)])
def test_the_file_holds_the_placed_device_and_no_other_change(name: str, shares: tuple[float, ...]) -> None:
    device = shipped(name)
    position_m = [point_at(device.surface.corner_m, round(share, 2), 0.1 + share / 2) for share in shares]
    read = Device.parse(placed_text(device, "placed", position_m), "placed.toml")
    expected = replace(with_actuators_at(device, position_m), name="placed")
    assert read.fingerprint == expected.fingerprint
    assert read.name == "placed"
