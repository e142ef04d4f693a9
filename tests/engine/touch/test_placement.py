"""Laws of placements, whose fingers are in order and can be told apart, and of places, an even grid from end to end."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from base.points import clip_points, order_of
from engine.touch import Placement, PlacementError, ZoneState
from engine.touch.placement import CLOSEST_M, MOST_FINGERS, Places, merged
from tests.engine.made_table import state_index
from tests.precompute.devices import shipped

DEVICE = shipped("reference-a")


def test_fingers_are_in_the_order_of_the_bar_each_with_its_role() -> None:
    placement = Placement.on(DEVICE, [0.2, 0.03], [0.1])
    assert placement.position_m == (0.03, 0.1, 0.2) and placement.is_felt == (True, False, True)
    assert placement.felt == [0, 2] and placement.quiet == [1]


def test_both_ends_belong_to_the_bar() -> None:
    length_m = DEVICE.bar.length_m
    assert Placement.on(DEVICE, [0.0], [length_m]).position_m == (0.0, length_m)
    for beside_m in (-1e-4, length_m + 1e-4, float("nan"), float("inf")):
        with pytest.raises(PlacementError, match="reaches from 0 to"):
            Placement.on(DEVICE, [beside_m])


def test_fingers_that_are_one_to_the_bar_are_refused() -> None:
    assert len(Placement.on(DEVICE, [0.1], [0.1 + CLOSEST_M]).position_m) == 2
    assert CLOSEST_M > 0.108 - 0.1  # by rounding
    assert len(Placement.on(DEVICE, [0.1], [0.108]).position_m) == 2
    for other_m in (0.1, 0.1 + 0.999 * CLOSEST_M):
        with pytest.raises(PlacementError, match="closer than 8 mm they are one"):
            Placement.on(DEVICE, [0.1], [other_m])


def test_there_are_one_to_ten_fingers() -> None:
    wide = replace(DEVICE, surface=replace(DEVICE.bar, length_m=1.0))
    apart = [0.05 * (1 + i) for i in range(MOST_FINGERS)]
    assert len(Placement.on(wide, [], apart).felt) == 0
    with pytest.raises(PlacementError, match="11 fingers: give 1 to 10"):
        Placement.on(wide, [0.9], apart)
    with pytest.raises(PlacementError, match="0 fingers"):
        Placement.on(wide, [])


def test_fingers_are_named_by_position_metres_or_zone() -> None:
    middle_m = (DEVICE.zones[3].start_m + DEVICE.zones[3].stop_m) / 2
    placement = Placement.named(DEVICE, ["35 mm", 0.1], ["IV"])
    assert placement == Placement((0.035, 0.1, middle_m), (True, True, False))
    for wrong in ("35", "35 g", "VI", ""):
        with pytest.raises(PlacementError, match="or one of the zones I, II, III, IV, V"):
            Placement.named(DEVICE, [wrong])
    with pytest.raises(PlacementError, match=r"give a list, such as \['35 mm'\]"):
        Placement.named(DEVICE, "35 mm")


def test_a_zone_is_felt_if_one_of_its_fingers_feels() -> None:
    first = DEVICE.zones[0]
    inside_m = [first.start_m + share * first.length_m for share in (0.2, 0.6)]
    free = (ZoneState.FREE,) * 4
    assert Placement.on(DEVICE, inside_m[:1], inside_m[1:]).zone_states(DEVICE) == (ZoneState.FELT, *free)
    assert Placement.on(DEVICE, [], inside_m).zone_states(DEVICE) == (ZoneState.QUIET, *free)
    assert state_index(Placement.on(DEVICE, inside_m).zone_states(DEVICE)) == 2


@given(st.lists(st.tuples(st.floats(0.0, 0.3), st.booleans()), min_size=1, max_size=12))
def test_what_is_left_of_joined_fingers_lies_apart_and_keeps_every_felt_one(fingers: list[tuple[float, bool]]) -> None:
    position_m, is_felt, joined = merged(fingers)
    assert len(position_m) + joined == len(fingers) and set(position_m) <= {at_m for at_m, _ in fingers}
    assert all(abs(after - before) >= CLOSEST_M - 1e-9 for before, after in itertools.pairwise(position_m))
    assert any(is_felt) == any(feels for _, feels in fingers)
    for at_m, feels in fingers:
        nearest = min(range(len(position_m)), key=lambda k: abs(position_m[k] - at_m))
        assert abs(position_m[nearest] - at_m) < CLOSEST_M
        if feels:
            assert any(
                felt and abs(other_m - at_m) < CLOSEST_M for other_m, felt in zip(position_m, is_felt, strict=True)
            )


LENGTH_M, CORNER_M = 0.2794, 0.3 + 0.18j
LENGTHS = st.floats(0.01, 1.0)
PITCHES = st.floats(1e-3, 0.05)


@example(0.3, 0.1)  # the division may come out a rounding above 3
@example(0.01, 1.0)
@given(LENGTHS, PITCHES)
def test_the_grid_reaches_from_end_to_end_in_as_few_places_as_the_pitch_allows(length_m: float, pitch_m: float) -> None:
    places = Places.every(length_m, pitch_m)
    assert places.position_m[0] == 0 and places.position_m[-1] == length_m
    assert places.pitch_m <= pitch_m * (1 + 1e-8)
    assert places.count == 2 or length_m / (places.count - 2) > pitch_m


@example(0.1, 0.1)
@given(st.floats(-1, 2), st.floats(-1, 2))
def test_a_finger_on_a_plate_belongs_to_the_nearest_place_along_and_across(along: float, across: float) -> None:
    places = Places.every(CORNER_M, 8e-3)
    at_m = complex(along * CORNER_M.real, across * CORNER_M.imag)
    away_m = places.position_m[places.nearest(at_m)] - clip_points(at_m, CORNER_M)
    assert max(abs(away_m.real), abs(away_m.imag)) <= places.pitch_m / 2 * (1 + 1e-9)


@pytest.mark.parametrize("places", [Places(LENGTH_M, 95), Places(CORNER_M, 5, 3), Places(CORNER_M, 2, 7)])
def test_places_are_found_again_from_their_points_and_from_no_others(places: Places) -> None:
    points_m = np.array(places.position_m)
    assert Places.at(places.corner_m, points_m.tolist()) == places
    beside_m, twice = points_m.copy(), np.concatenate([points_m, points_m[-1:]])
    beside_m[1] += 1e-6
    for wrong_m in (beside_m, points_m[::-1], points_m[:-1], twice, points_m[:1], points_m[:0], 0 * points_m):
        with pytest.raises(ValueError, match="even grid"):
            Places.at(places.corner_m, wrong_m.tolist())


@given(
    st.sampled_from([Places(LENGTH_M, 95), Places(0.3 + 0.15j, 19, 10)]),
    st.lists(st.tuples(st.integers(0, 94), st.booleans()), min_size=1, max_size=10, unique_by=lambda each: each[0]),
    st.floats(-0.49, 0.49),
)
def test_a_key_is_that_of_its_own_placement_and_of_fingers_beside_it(
    places: Places, fingers: list[tuple[int, bool]], pitches: float
) -> None:
    key = tuple(sorted(2 * place + is_felt for place, is_felt in fingers))
    placement = places.placement(key)
    beside_m = tuple(at_m + pitches * places.pitch_m for at_m in placement.position_m)
    assert places.key(placement) == places.key(Placement(beside_m, placement.is_felt)) == key
    assert list(placement.position_m) == sorted(placement.position_m, key=order_of)
    assert sum(placement.is_felt) == sum(is_felt for _, is_felt in fingers)
