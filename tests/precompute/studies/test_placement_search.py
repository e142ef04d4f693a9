"""The search for places of actuators: what it looks at can be built, and what it ends at is the best of that."""

from itertools import combinations, pairwise
from math import comb

import numpy as np
import pytest

from base.points import is_within, order_of
from engine.device import Device
from engine.device.description import check_clamps
from precompute.studies.placement_search import (
    APART,
    MARGIN,
    PlacementSearch,
    _moves,
    even_places,
    grid_of,
    own_places,
    screen_two_fingers,
    search_placement,
    solve_two_fingers,
    with_actuators_at,
    with_equal_zones,
)
from tests.precompute.devices import coarsely_swept, shipped, with_actuators

pytestmark = pytest.mark.long

MOST = 20


def small() -> Device:
    return coarsely_swept(with_equal_zones(shipped("reference-a"), 2))


@pytest.fixture(scope="module")
def found() -> PlacementSearch:
    return search_placement(small(), 2, 20.0, MOST, lambda _: None)


def test_more_actuators_repeat_those_of_the_device_in_their_order() -> None:
    left, right = shipped("reference-a").actuators
    placed = with_actuators_at(shipped("reference-a"), [0.2, 0.1, 0.05, 0.25]).actuators
    assert [actuator.position_m for actuator in placed] == [0.05, 0.1, 0.2, 0.25]
    stiffness = [actuator.stiffness_n_per_m for actuator in placed]
    assert stiffness == [left.stiffness_n_per_m] * 2 + [right.stiffness_n_per_m] * 2
    assert len({actuator.name for actuator in placed}) == 4


@pytest.mark.parametrize(("count", "most"), [(1, 7), (2, 20), (2, 300), (3, 300), (4, 300)])
def test_the_grid_holds_as_many_placements_as_allowed_and_they_can_be_built(count: int, most: int) -> None:
    device = shipped("reference-a")
    grid, step_m = grid_of(device, count, most)
    points = round((1 - 2 * MARGIN) * device.bar.length_m / step_m) + 1
    assert comb(points, count) <= most < comb(points + 1, count)
    for at in grid:
        along_m = [each_m.real for each_m in at]
        assert MARGIN * device.bar.length_m - 1e-9 <= along_m[0]
        assert along_m[-1] <= (1 - MARGIN) * device.bar.length_m + 1e-9
        assert all(b - a >= APART * device.bar.length_m - 2e-6 for a, b in pairwise(along_m))


@pytest.mark.parametrize("count", [1, 3, 4, 6])
def test_a_plate_s_grid_and_moves_are_in_two_dimensions_and_can_be_built(count: int) -> None:
    device, most = shipped("reference-p"), 100
    corner_m, apart_m = device.surface.corner_m, APART * device.surface.length_m
    grid, _ = grid_of(device, count, most)
    assert 1 < len(grid) <= most
    middle = even_places(device, count)
    moves = list(_moves(device, middle, 0.02))
    assert len(moves) == 4 * count, "each of them along and across, both ways"
    assert abs(np.mean(middle) - corner_m / 2) < 1e-9, "nearly equal parts leave the middle where it is"
    for at in [*grid, *moves, middle]:
        assert list(at) == sorted(at, key=order_of) and len(set(at)) == count
        assert all(is_within(each_m - MARGIN * corner_m, (1 - 2 * MARGIN) * corner_m, 1e-9) for each_m in at)
        assert all(abs(one_m - other_m) >= apart_m - 2e-6 for one_m, other_m in combinations(at, 2))


def test_clamps_of_placements_do_not_meet() -> None:
    device = with_actuators(shipped("reference-a"), clamp_m=0.03)
    grid, _ = grid_of(device, 3, 300)
    assert len(grid) > 20
    for at in grid:
        check_clamps("a placement", device.surface, with_actuators_at(device, at).actuators)


def test_what_is_found_is_screened_as_no_worse_than_any_placement_of_the_grid(found: PlacementSearch) -> None:
    device = small()
    best = next(placement for placement in found.evaluated if placement.name == "found")
    again = screen_two_fingers(with_actuators_at(device, best.position_m), 20.0, 2.0)
    on_the_grid = [
        screen_two_fingers(with_actuators_at(device, at), 20.0, 2.0).rank
        for at in found.screened_m[np.argsort(-np.nan_to_num(found.screened_db, nan=-99.0))[:2]].tolist()
    ]
    assert again.rank >= max(on_the_grid)
    assert found.moved > 4 and found.count == 2


def test_the_best_judged_comes_first_and_the_even_and_the_described_placement_are_among_them(
    found: PlacementSearch,
) -> None:
    ranks = [placement.fingers.rank for placement in found.evaluated]
    assert ranks == sorted(ranks, reverse=True)
    named = {placement.name: placement for placement in found.evaluated}
    assert named.keys() == {"found", "even", "as described"}
    assert named["even"].position_m == even_places(small(), 2) == pytest.approx((0.06985, 0.20955))
    assert named["as described"].position_m == own_places(small())
    solved = solve_two_fingers(small(), 20.0)
    assert named["as described"].fingers.worst_db == pytest.approx(solved.worst_db, abs=1e-9)


def test_what_is_found_is_never_worse_than_the_even_placement() -> None:
    """With this grid the best screened places of one actuator are worse than the middle of the bar."""
    search = search_placement(small(), 1, 20.0, 4, lambda _: None)
    found, even = search.evaluated
    assert (found.name, even.name) == ("found", "even")
    assert found.fingers.rank >= even.fingers.rank
    assert found.fingers.worst_db > 0.2  # next to the middle, where the search that starts there ends
