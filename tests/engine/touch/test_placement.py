"""Laws of placements: fingers in the order of the bar, and none that the bar could not tell apart."""

from dataclasses import replace

import pytest

from engine.touch import Placement, PlacementError, ZoneState
from engine.touch.placement import CLOSEST_M, MOST_FINGERS
from tests.precompute.devices import shipped

DEVICE = shipped("reference-a")


def test_fingers_are_in_the_order_of_the_bar_each_with_its_role() -> None:
    placement = Placement.on(DEVICE, [0.2, 0.03], [0.1])
    assert placement.position_m == (0.03, 0.1, 0.2) and placement.is_felt == (True, False, True)
    assert placement.felt == [0, 2] and placement.quiet == [1]


def test_a_zone_stands_for_its_middle() -> None:
    states = (ZoneState.QUIET, ZoneState.FREE, ZoneState.FELT, ZoneState.FREE, ZoneState.FREE)
    first, third = DEVICE.zones[0], DEVICE.zones[2]
    assert Placement.in_zones(DEVICE, states) == Placement.on(
        DEVICE, [(third.start_m + third.stop_m) / 2], [(first.start_m + first.stop_m) / 2]
    )


def test_both_ends_belong_to_the_bar() -> None:
    length_m = DEVICE.bar.length_m
    assert Placement.on(DEVICE, [0.0], [length_m]).position_m == (0.0, length_m)
    for beside_m in (-1e-4, length_m + 1e-4, float("nan"), float("inf")):
        with pytest.raises(PlacementError, match="reaches from 0 to"):
            Placement.on(DEVICE, [beside_m])


def test_fingers_that_are_one_to_the_bar_are_refused() -> None:
    assert len(Placement.on(DEVICE, [0.1], [0.1 + CLOSEST_M]).position_m) == 2
    for other_m in (0.1, 0.1 + 0.999 * CLOSEST_M):
        with pytest.raises(PlacementError, match="closer than 8 mm they are one"):
            Placement.on(DEVICE, [0.1], [other_m])


def test_there_are_one_to_ten_fingers() -> None:
    wide = replace(DEVICE, bar=replace(DEVICE.bar, length_m=1.0))
    apart = [0.05 * (1 + i) for i in range(MOST_FINGERS)]
    assert len(Placement.on(wide, [], apart).felt) == 0
    with pytest.raises(PlacementError, match="11 fingers: give 1 to 10"):
        Placement.on(wide, [0.9], apart)
    with pytest.raises(PlacementError, match="0 fingers"):
        Placement.on(wide, [])
