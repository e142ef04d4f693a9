"""Laws of positions, zones and states."""

from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from engine.device import Device, TouchAxis, Zone
from engine.device.parts import TouchAcross
from engine.touch import Contact, FingerTracker, Touch, TouchFrame
from engine.touch.descriptor import read_surfaces
from engine.touch.finger_tracker import TouchPosition, ZoneFinder
from tests.engine.touch.descriptors import application, finger
from tests.precompute.devices import shipped

REFERENCE = shipped("reference-a")
LENGTH_M = REFERENCE.bar.length_m
SURFACE = read_surfaces(application(finger(), finger()))[0]  # x and y from 0 to 1000
OTHER_Y = bytes.fromhex("169cff 26bc02 0931")  # a logical range of its own
UNEQUAL = read_surfaces(application(finger().replace(b"\x09\x31", OTHER_Y)))[0]  # y from -100 to 700
LAST = 1000
logical = st.integers(0, LAST)
fractions = st.floats(0, 1)


@st.composite
def touch_axes(draw: st.DrawFn) -> TouchAxis:
    """Any touch area that covers some of the bar, and perhaps more than the bar on either side."""
    start_m = draw(st.floats(-2 * LENGTH_M, 0.9 * LENGTH_M))
    left_m = LENGTH_M - max(start_m, 0.0)
    end_m = draw(st.floats(-2 * LENGTH_M, 0.9 * left_m))
    before_m = max(-start_m, 0.0)
    active_m = draw(st.none() | st.floats(before_m + 0.01 * left_m, before_m + 2 * LENGTH_M))
    return TouchAxis(draw(st.sampled_from(["x", "y"])), draw(st.booleans()), start_m, end_m, active_m)


@st.composite
def zoned_devices(draw: st.DrawFn) -> Device:
    """One to five zones with or without gaps, and a hysteresis under half of the shortest."""
    edges_m = sorted(draw(st.lists(st.integers(0, 10_000), min_size=2, max_size=10, unique=True)))
    edges_m = edges_m[: len(edges_m) // 2 * 2]
    is_gapless = draw(st.booleans())
    pairs = pairwise(edges_m) if is_gapless else zip(edges_m[::2], edges_m[1::2], strict=True)
    zones = tuple(Zone(str(i), a / 10_000 * LENGTH_M, b / 10_000 * LENGTH_M) for i, (a, b) in enumerate(pairs))
    hysteresis_m = draw(st.floats(0, 0.49)) * min(zone.length_m for zone in zones)
    return replace(REFERENCE, zones=zones, zone_hysteresis_m=hysteresis_m)


def with_axis(axis: TouchAxis) -> Device:
    return replace(REFERENCE, touch_axis=axis)


def at(value: int, contact_id: int = 1, *, tip: bool = True) -> Contact:
    return Contact(contact_id, value, value, tip)


def frame_of(*contacts: Contact) -> TouchFrame:
    return TouchFrame(0, contacts)


@given(touch_axes(), logical, logical)
def test_a_position_is_where_the_touch_area_has_it_or_nearest_on_the_bar(axis: TouchAxis, x: int, y: int) -> None:
    position_m = TouchPosition(with_axis(axis), UNEQUAL).position_m(Contact(1, x, y, True)).real
    assert 0 <= position_m <= LENGTH_M
    value, first, last = (x, 0, LAST) if axis.axis == "x" else (y, -100, 700)
    active_m = axis.active_length_m or LENGTH_M - axis.start_margin_m - axis.end_margin_m
    fraction = (last - value if axis.flip else value - first) / (last - first)
    touched_m = axis.start_margin_m + fraction * active_m
    assert position_m == pytest.approx(sorted([0.0, touched_m, LENGTH_M])[1], abs=1e-12)


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("end_m", [0.0, LENGTH_M])
def test_a_fingertip_on_the_end_is_a_finger_until_it_lifts_however_far_it_slides(end_m: float, flip: bool) -> None:
    device = with_axis(TouchAxis("x", flip, -0.1, -0.1, None))

    def touches(beyond_mm: float, *, tip: bool = True) -> list[Touch]:
        at_m = end_m + (1 if end_m else -1) * beyond_mm / 1e3
        value = round(LAST * (at_m + 0.1) / (LENGTH_M + 0.2))
        return tracker.track(frame_of(at(LAST - value if flip else value, tip=tip)))

    tracker, zone = FingerTracker(device, SURFACE), 4 if end_m else 0
    assert touches(9) == []
    assert touches(7) == touches(90) == [Touch(1, end_m, zone)]
    assert touches(90, tip=False) == touches(90) == []


def test_a_finger_beside_any_side_of_a_plate_is_none_and_on_an_edge_of_zones_it_is_in_the_last() -> None:
    plate = shipped("reference-p")
    across = TouchAcross(False, -0.1, -0.1, None)
    tracker = FingerTracker(replace(plate, touch_axis=TouchAxis("x", False, -0.1, -0.1, None, across=across)), SURFACE)

    def zones(x_m: float, y_m: float) -> list[int | None]:
        tracker.track(frame_of(at(0, tip=False)))
        x, y = (round(LAST * (at_m + 0.1) / (side_m + 0.2)) for at_m, side_m in ((x_m, 0.3), (y_m, 0.18)))
        return [touch.zone for touch in tracker.track(frame_of(Contact(1, x, y, True)))]

    assert zones(0.05, 0.05) == [0] and zones(0.25, 0.15) == [5]
    for beside in ((-0.05, 0.05), (0.35, 0.05), (0.05, -0.05), (0.05, 0.23), (-0.05, -0.05)):
        assert zones(*beside) == []
    edges = ZoneFinder(plate)
    middle_m, corner_m = plate.zones[0].stop_m, plate.surface.corner_m
    assert (edges.zone_at(middle_m), edges.zone_at(corner_m), edges.zone_at(corner_m + 0.01)) == (4, 5, None)


def test_another_bar_decides_anew_which_contacts_are_its_fingers() -> None:
    axis = TouchAxis("x", False, 0.0, 0.0, LENGTH_M)
    long = with_axis(axis)
    short = replace(long, surface=replace(long.bar, length_m=LENGTH_M / 2), zones=long.zones[:2])
    tracker = FingerTracker(long, SURFACE)
    frame = frame_of(at(LAST // 4, 1), at(3 * LAST // 4, 2), at(LAST // 8, 3, tip=False))
    on_long = tracker.track(frame)
    on_short = tracker.change_bar(short)
    assert [touch.contact_id for touch in on_long] == [1, 2]
    assert [touch.contact_id for touch in on_short] == [1] and tracker.track(frame) == on_short
    assert tracker.change_bar(long) == on_long


@given(zoned_devices(), fractions)
def test_a_new_contact_is_in_the_zone_that_holds_it_or_in_none(device: Device, fraction: float) -> None:
    position_m = fraction * LENGTH_M
    zone = ZoneFinder(device).zone_at(position_m)
    holding = [i for i, each in enumerate(device.zones) if each.start_m.real <= position_m <= each.stop_m.real]
    assert zone == (holding[-1] if holding else None)


@given(zoned_devices(), st.lists(fractions, min_size=1, max_size=20))
def test_a_contact_stays_in_its_zone_until_past_an_edge_by_the_hysteresis(device: Device, path: list[float]) -> None:
    edges, zone = ZoneFinder(device), None
    reach_m = [(each.start_m - edges.hysteresis_m, each.stop_m + edges.hysteresis_m) for each in device.zones]
    for fraction in path:
        previous, position_m = zone, fraction * LENGTH_M
        zone = edges.zone_at(position_m, previous)
        stays = previous is not None and reach_m[previous][0] <= position_m <= reach_m[previous][1]
        assert zone == (previous if stays else edges.zone_at(position_m))
    for i, ends_m in enumerate(reach_m):
        assert [edges.zone_at(end_m, i) for end_m in ends_m] == [i, i]


@given(zoned_devices(), st.lists(fractions, max_size=5))
def test_without_a_past_a_touch_is_where_its_contact_is(device: Device, places: list[float]) -> None:
    contacts = [at(round(LAST * place), i) for i, place in enumerate(places)]
    tracker, position, edges = FingerTracker(device, SURFACE), TouchPosition(device, SURFACE), ZoneFinder(device)
    places_m = [position.position_m(contact) for contact in contacts]
    touches = [Touch(i, place_m, edges.zone_at(place_m)) for i, place_m in enumerate(places_m)]
    assert tracker.track(frame_of(*contacts)) == touches


def test_hysteresis_is_per_contact_and_ends_with_the_touch_also_where_the_finger_hovers() -> None:
    tracker = FingerTracker(REFERENCE, SURFACE)
    past_edge = 202  # zone I stops at 200; the hysteresis of 2 mm is 7.2 units

    def zones(*contacts: Contact) -> list[int | None]:
        return [touch.zone for touch in tracker.track(frame_of(*contacts))]

    assert zones(at(195, 1)) == [0]
    assert zones(at(past_edge, 1)) == [0]
    assert zones(at(past_edge, 1), at(past_edge, 2)) == [0, 1]
    for ended in ([], [at(past_edge, 1, tip=False)]):
        assert zones(at(150, 1)) == zones(at(past_edge, 1)) == [0]
        assert zones(*ended) == []
        assert zones(at(past_edge, 1)) == [1]


def test_a_contact_that_the_digitizer_hands_out_again_is_the_same_finger() -> None:
    tracker, rests, moves = FingerTracker(REFERENCE, SURFACE), at(195, 1), at(700, 2)
    first = tracker.track(frame_of(rests, moves))
    again = tracker.track(frame_of(rests, at(720, 2)))
    assert again[0] is first[0]
    assert again[1].position_m.real > first[1].position_m.real
