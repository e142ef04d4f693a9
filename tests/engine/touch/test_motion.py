"""Finger velocity: what a drag is, whatever the digitizer's rate."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from engine.touch import Contact, TouchFrame, open_digitizer
from engine.touch.motion import FingerMotion
from tactable.rig.virtual_digitizer import DESCRIPTOR, X_MAXIMUM
from tactable.shipped import find_device

DEVICE = find_device("reference-a")
SURFACE = open_digitizer(DESCRIPTOR).surface
LENGTH_M = DEVICE.bar.length_m


def frame(time_s: float, *places: float, tip: bool = True, scan_time_s: float | None = None) -> TouchFrame:
    contacts = tuple(Contact(i, round(place * X_MAXIMUM), 0, tip) for i, place in enumerate(places))
    return TouchFrame(round(time_s * 1e9), contacts, None if scan_time_s is None else round(scan_time_s * 1e9))


@given(st.floats(-0.5, 0.5), st.sampled_from([0.002, 0.004, 0.008, 0.016, 0.026]))
def test_a_steady_drag_has_its_speed_at_any_frame_rate(speed_m_per_s: float, period_s: float) -> None:
    motion, start = FingerMotion(DEVICE, SURFACE), 0.5
    for i in range(int(0.2 / period_s)):
        found = motion.track(frame(i * period_s, start + speed_m_per_s * i * period_s / LENGTH_M))
    resolution = LENGTH_M / X_MAXIMUM / period_s
    assert found[0] == pytest.approx(speed_m_per_s, abs=2 * resolution + 1e-3 * abs(speed_m_per_s) + 1e-6)


def test_a_finger_comes_down_and_rests_without_speed() -> None:
    motion = FingerMotion(DEVICE, SURFACE)
    assert motion.track(frame(0.0, 0.3)) == {0: 0.0}
    assert motion.track(frame(0.008, 0.3)) == {0: 0.0}
    assert motion.track(frame(0.016)) == {}
    assert motion.track(frame(0.024, 0.9)) == {0: 0.0}


def test_fingers_move_apart_and_hovering_ones_not_at_all() -> None:
    motion = FingerMotion(DEVICE, SURFACE)
    motion.track(frame(0.0, 0.4, 0.6))
    found = motion.track(frame(0.01, 0.3, 0.7))
    assert found[0] < 0 < found[1]
    assert motion.track(frame(0.02, 0.3, 0.7, tip=False)) == {}


def test_jitter_of_the_host_does_not_show_where_the_digitizer_tells_the_time() -> None:
    steady, shaken = FingerMotion(DEVICE, SURFACE), FingerMotion(DEVICE, SURFACE)
    for i in range(20):
        time_s = 0.008 * i
        expected = steady.track(frame(time_s, 0.2 + 0.01 * i, scan_time_s=time_s))
        found = shaken.track(frame(time_s + 0.003 * (i % 2), 0.2 + 0.01 * i, scan_time_s=time_s))
    assert found == expected


def test_a_time_that_stands_still_keeps_the_speed() -> None:
    motion = FingerMotion(DEVICE, SURFACE)
    motion.track(frame(0.0, 0.2))
    before = motion.track(frame(0.008, 0.21))
    assert motion.track(frame(0.008, 0.25)) == before
