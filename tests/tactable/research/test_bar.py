"""Modes and responses as labelled arrays: laws, units, and what they were computed from."""

import numpy as np
import pytest

import tactable
from engine.touch import PlacementError
from tactable import Device
from tests.small_device import small_text


def small_device() -> Device:
    return Device.parse(small_text(), "my-bar.toml")


def test_modes_are_those_of_the_bar_and_a_finger_damps_them() -> None:
    device = small_device()
    untouched, touched = tactable.modes(device, up_to_hz=400), tactable.modes(device, ["II"], up_to_hz=400)
    assert (np.diff(untouched.frequency) > 0).all()
    assert abs(untouched["shape"]).max("position").values == pytest.approx(1.0)
    assert float(touched.damping_ratio.max()) > float(untouched.damping_ratio.max())
    assert untouched.decay_time.values == pytest.approx(
        1 / (2 * np.pi * untouched.frequency * untouched.damping_ratio).values
    )
    assert untouched.attrs["device_fingerprint"] == device.fingerprint
    assert "bar.length" in untouched.attrs["estimates"]


def test_no_mode_is_an_empty_set() -> None:
    assert dict(tactable.modes(small_device(), up_to_hz=1e-3).sizes)["mode"] == 0


def test_a_response_is_proportional_to_full_scale_of_its_actuator_alone() -> None:
    device = small_device()
    twice = device.with_values({"actuator[1].full_scale": "1.04 µm"})
    one, two = (tactable.response(each, 150.0, [0.03, 0.12], fingers=["35 mm"]) for each in (device, twice))
    assert one.dims == ("frequency", "actuator", "position") and one.shape == (1, 2, 2)
    assert (two / one).sel(actuator="left").values == pytest.approx(np.full((1, 2), 2.0))
    assert (two / one).sel(actuator="right").values == pytest.approx(np.ones((1, 2)))


def test_a_finger_beside_the_bar_is_refused() -> None:
    with pytest.raises(PlacementError, match=r"a finger at 900 mm: .* reaches from 0 to"):
        tactable.modes(small_device(), ["900 mm"])
    assert tactable.placement(small_device(), ["35 mm"], ["III"]).is_felt == (True, False)
