"""One finger felt, one quiet: the drives that a run solves, and a screening that comes near them."""

import numpy as np
import pytest

from engine.device import Device
from precompute.studies.two_fingers import TwoFingers, finger_pairs, solve_two_fingers
from precompute.studies.zone_resolution import with_equal_zones
from tests.precompute.devices import coarsely_swept, shipped


def small(name: str = "reference-a") -> Device:
    return coarsely_swept(with_equal_zones(shipped(name), 3))


@pytest.fixture(scope="module")
def solved() -> TwoFingers:
    return solve_two_fingers(small(), 20.0)


def test_every_two_zones_are_a_pair_both_ways_round_and_the_worst_one_is_the_least(solved: TwoFingers) -> None:
    assert sorted(finger_pairs(small())) == [(0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)]
    assert np.isnan(np.diag(solved.contrast_db)).all() and np.isfinite(solved.contrast_db).sum() == 6
    assert solved.is_reached and solved.worst_db == np.nanmin(solved.contrast_db) > 3.0
