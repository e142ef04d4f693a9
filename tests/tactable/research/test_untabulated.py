"""Modes and responses as labelled arrays: laws, units, and what they were computed from."""

import numpy as np
import pytest

import tactable
from engine.touch import PlacementError
from tactable import Device
from tests.small_device import small_text

DEVICE = Device.parse(small_text(), "my-bar.toml")


def test_modes_are_those_of_the_bar_and_a_finger_damps_them() -> None:
    untouched, touched = tactable.modes(DEVICE, up_to_hz=400), tactable.modes(DEVICE, ["II"], up_to_hz=400)
    assert (np.diff(untouched.frequency) > 0).all()
    assert abs(untouched["shape"]).max("position").values == pytest.approx(1.0)
    assert float(touched.damping_ratio.max()) > float(untouched.damping_ratio.max())
    per_s = 2 * np.pi * untouched.frequency * untouched.damping_ratio
    assert untouched.decay_time.values == pytest.approx(1 / per_s.values)
    assert untouched.attrs["device_fingerprint"] == DEVICE.fingerprint
    assert "bar.length" in untouched.attrs["estimates"]
    assert dict(tactable.modes(DEVICE, up_to_hz=1e-3).sizes)["mode"] == 0


def test_a_finger_beside_the_bar_is_refused() -> None:
    with pytest.raises(PlacementError, match=r"a finger at 900 mm: .* reaches from 0 to"):
        tactable.modes(DEVICE, ["900 mm"])
    assert tactable.placement(DEVICE, ["35 mm"], ["III"]).is_felt == (True, False)
