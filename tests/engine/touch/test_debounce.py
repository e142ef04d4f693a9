"""Laws of gaps: a panel that drops a resting finger for moments, and silence by the device file."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from engine.touch import Contact, Digitizer, TouchFrame, open_digitizer
from engine.touch.debounce import fit_releases
from engine.touch.placement import CLOSEST_M
from tests.engine.touch.descriptors import HYBRID
from tests.engine.touch.test_digitizer import NOBODY, Finger, hybrid
from tests.precompute.devices import shipped

MS = 1_000_000
DEVICE = shipped("reference-a")
NEAR = int(1000 * CLOSEST_M / DEVICE.bar.length_m)
"""Logical units that CLOSEST_M is."""


def fitted(silence_s: float | None = None, debounce_s: float = 0.03) -> Digitizer:
    digitizer = open_digitizer(HYBRID, 0x1234, 1)
    axis = replace(DEVICE.touch_axis, silence_s=silence_s, debounce_s=debounce_s)
    fit_releases(digitizer, replace(DEVICE, touch_axis=axis))
    return digitizer


def show(digitizer: Digitizer, time_ms: int, *fingers: Finger) -> dict[int, int]:
    """Numbers and places of the frame of a report of up to two fingers."""
    first, second, *_ = (*fingers, NOBODY, NOBODY)
    frame = digitizer.decode_report(hybrid(first, second, len(fingers)), time_ms * MS)
    assert frame is not None
    return {contact.contact_id: contact.x for contact in frame.contacts}


@pytest.mark.parametrize(("gap_ms", "away", "number"), [(29, NEAR, 1), (29, NEAR + 1, 2), (30, 0, 2)])
def test_a_short_gap_at_a_place_is_no_lift_also_under_another_number(gap_ms: int, away: int, number: int) -> None:
    digitizer = fitted()
    assert show(digitizer, 0, Finger(1)) == {1: 100}
    assert show(digitizer, 8, Finger(1, flags=0)) == {1: 100}
    digitizer.expire((8 + gap_ms) * MS)
    found = show(digitizer, 8 + gap_ms, Finger(2, 100 + away))
    assert found[number] == 100 + away
    assert (1 in found) is (gap_ms < 30)


def test_a_lift_is_known_when_it_has_lasted_and_no_report_is_needed() -> None:
    digitizer = fitted()
    show(digitizer, 0, Finger(1), Finger(2, 900))
    show(digitizer, 8, Finger(1, flags=0), Finger(2, 900))
    assert (digitizer.due_ns, digitizer.expire(38 * MS - 1)) == (38 * MS, None)
    assert digitizer.expire(38 * MS) == TouchFrame(38 * MS, (Contact(2, 900, 200, tip=True),))
    assert digitizer.due_ns is None


def test_a_number_that_comes_down_elsewhere_during_its_gap_is_another_finger() -> None:
    digitizer = fitted()
    show(digitizer, 0, Finger(1))
    show(digitizer, 8, Finger(1, flags=0))
    assert sorted(show(digitizer, 16, Finger(1, 900)).values()) == [100, 900]
    (contact,) = digitizer.expire(38 * MS).contacts  # type: ignore[union-attr]  # the law
    assert contact.contact_id != 1
    assert show(digitizer, 40, Finger(1, 910)) == {contact.contact_id: 910}


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 1000), st.booleans(), st.integers(1, 60)), max_size=30))
def test_numbers_are_unique_and_all_lifts_are_known_in_the_end(moves: list[tuple[int, int, bool, int]]) -> None:
    digitizer, time_ms = fitted(), 0
    for contact_id, x, touches, pause_ms in moves:
        time_ms += pause_ms
        digitizer.expire(time_ms * MS)
        frame = digitizer.decode_report(hybrid(Finger(contact_id, x, flags=touches), NOBODY, 1), time_ms * MS)
        assert frame is not None and len({contact.contact_id for contact in frame.contacts}) == len(frame.contacts)
    for contact_id in range(4):
        show(digitizer, time_ms, Finger(contact_id, flags=0))
    last = digitizer.expire((time_ms + 30) * MS)
    assert digitizer.due_ns is None and (last is None or last.contacts == ())


def test_silence_of_the_device_file_releases_a_panel_without_certificate() -> None:
    digitizer = fitted(silence_s=0.2)
    show(digitizer, 0, Finger(1))
    assert digitizer.due_ns == 200 * MS
    assert digitizer.expire(200 * MS) == TouchFrame(200 * MS, ())
    assert show(digitizer, 300, Finger(1)) == {1: 100}
