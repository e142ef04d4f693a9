"""Laws of places: an even grid from end to end, the nearest one, and keys that lead back to their placements."""

from hypothesis import given
from hypothesis import strategies as st

from engine.touch import Placement
from engine.touch.places import Places

LENGTH_M = 0.2794
LENGTHS = st.floats(0.01, 1.0)
PITCHES = st.floats(1e-3, 0.05)


def test_the_grid_reaches_from_end_to_end_in_as_few_places_as_the_pitch_allows() -> None:
    assert Places.every(LENGTH_M, 3e-3).count == 95
    assert Places.every(0.3, 0.1).count == 4  # the division may come out a rounding above 3
    assert Places.every(0.01, 1.0).count == 2


@given(LENGTHS, PITCHES)
def test_neighbouring_places_are_at_most_the_pitch_apart(length_m: float, pitch_m: float) -> None:
    places = Places.every(length_m, pitch_m)
    assert places.position_m[0] == 0 and places.position_m[-1] == length_m
    assert places.pitch_m <= pitch_m * (1 + 1e-8)
    assert places.count == 2 or length_m / (places.count - 2) > pitch_m


@given(LENGTHS, PITCHES, st.floats(0, 1))
def test_a_finger_belongs_to_the_place_at_most_half_a_pitch_away(length_m: float, pitch_m: float, part: float) -> None:
    places, at_m = Places.every(length_m, pitch_m), part * length_m
    assert abs(places.position_m[places.nearest(at_m)] - at_m) <= places.pitch_m / 2 * (1 + 1e-9)


def test_beyond_an_end_the_last_place_is_the_nearest() -> None:
    places = Places(LENGTH_M, 95)
    assert places.nearest(-0.01) == 0 and places.nearest(LENGTH_M + 0.01) == 94


@given(st.lists(st.tuples(st.integers(0, 94), st.booleans()), min_size=1, max_size=10, unique_by=lambda each: each[0]))
def test_a_key_is_that_of_its_own_placement(fingers: list[tuple[int, bool]]) -> None:
    places = Places(LENGTH_M, 95)
    key = tuple(sorted(2 * place + is_felt for place, is_felt in fingers))
    placement = places.placement(key)
    assert places.key(placement) == key
    assert list(placement.position_m) == sorted(placement.position_m)
    assert sum(placement.is_felt) == sum(is_felt for _, is_felt in fingers)


def test_a_finger_at_the_edge_between_two_places_takes_the_upper_one() -> None:
    places = Places(0.1, 11)
    assert places.key(Placement((0.0049, 0.0151), (True, False))) == (1, 4)
