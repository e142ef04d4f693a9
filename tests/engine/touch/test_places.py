"""Laws of places: an even grid from end to end, the nearest one, and keys that lead back to their placements."""

from hypothesis import example, given
from hypothesis import strategies as st

from engine.touch import Placement
from engine.touch.places import Places

LENGTH_M = 0.2794
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


@given(LENGTHS, PITCHES, st.floats(-1, 2))
def test_a_finger_belongs_to_the_place_at_most_half_a_pitch_away(length_m: float, pitch_m: float, part: float) -> None:
    """Beyond an end of the bar it belongs to the last place."""
    places, on_bar_m = Places.every(length_m, pitch_m), min(max(part, 0), 1) * length_m
    assert abs(places.position_m[places.nearest(part * length_m)] - on_bar_m) <= places.pitch_m / 2 * (1 + 1e-9)


@given(
    st.lists(st.tuples(st.integers(0, 94), st.booleans()), min_size=1, max_size=10, unique_by=lambda each: each[0]),
    st.floats(-0.49, 0.49),
)
def test_a_key_is_that_of_its_own_placement_and_of_fingers_beside_it(
    fingers: list[tuple[int, bool]], pitches: float
) -> None:
    places = Places(LENGTH_M, 95)
    key = tuple(sorted(2 * place + is_felt for place, is_felt in fingers))
    placement = places.placement(key)
    beside_m = tuple(at_m + pitches * places.pitch_m for at_m in placement.position_m)
    assert places.key(placement) == places.key(Placement(beside_m, placement.is_felt)) == key
    assert list(placement.position_m) == sorted(placement.position_m)
    assert sum(placement.is_felt) == sum(is_felt for _, is_felt in fingers)
