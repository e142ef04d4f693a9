"""The emulated part: counts as its data sheet says, at its own pace, and texts that are refused."""

import pytest

from tactable.rig.accelerometer import (
    AccelerometerError,
    EmulatedAccelerometer,
    SensedSurface,
)
from tests.engine.loop.rig import DEVICE
from tests.tactable.page.test_plate_page import plate


def test_a_point_on_the_surface_is_taken_and_one_beside_it_refused() -> None:
    for device, here, beside in (
        (DEVICE, "at=50mm", ("at=50 x 20 mm", "at=900mm")),
        (plate(), "at=0 x 120 mm", ("at=50mm", "at=50 x 121 mm")),
    ):
        SensedSurface(device, EmulatedAccelerometer.parse(here), 1)
        for text in beside:
            with pytest.raises(AccelerometerError, match=f"off the {device.surface.kind}"):
                SensedSurface(device, EmulatedAccelerometer.parse(text), 1)
