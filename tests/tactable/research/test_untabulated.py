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


def test_a_response_is_proportional_to_full_scale_of_its_actuator_alone() -> None:
    twice = DEVICE.with_values({"actuator[1].full_scale": "1.04 µm"})
    one, two = (tactable.response(each, 150.0, [0.03, 0.12], fingers=["35 mm"]) for each in (DEVICE, twice))
    assert one.dims == ("frequency", "actuator", "position") and one.shape == (1, 2, 2)
    assert (two / one).sel(actuator="left").values == pytest.approx(np.full((1, 2), 2.0))
    assert (two / one).sel(actuator="right").values == pytest.approx(np.ones((1, 2)))


def test_a_finger_beside_the_bar_is_refused() -> None:
    with pytest.raises(PlacementError, match=r"a finger at 900 mm: .* reaches from 0 to"):
        tactable.modes(DEVICE, ["900 mm"])
    assert tactable.placement(DEVICE, ["35 mm"], ["III"]).is_felt == (True, False)
