"""Laws of places: an even grid from end to end, the nearest one, and keys that lead back to their placements."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from base.points import clip_points, order_of
from engine.touch import Placement
from engine.touch.placement import Places

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
