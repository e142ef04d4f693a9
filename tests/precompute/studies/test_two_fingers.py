"""One finger felt, one quiet: as the entries of a table, mirrored with the bar, never passed by the screening."""

from dataclasses import replace

import numpy as np
import pytest

from engine.device import Device
from engine.touch import ZoneState
from precompute.entries.solver import EntrySolver
from precompute.model.assembly import assemble
from precompute.sampling.fingers import sample_fingers
from precompute.studies.two_fingers import TwoFingers, finger_pairs, screen_two_fingers, solve_two_fingers
from tests.precompute.devices import shipped, with_actuators, with_zones
from tests.quick import first_quick

SEARCH_DB = 0.05
"""The entries' own claim: so far from the optimum at most."""


def small(name: str = "reference-a") -> Device:
    device = with_zones(shipped(name), 3)
    return replace(device, sweep=replace(device.sweep, step_hz=4.0))


@pytest.fixture(scope="module")
def solved() -> TwoFingers:
    return solve_two_fingers(small(), 20.0)


def test_it_is_what_the_entries_of_a_table_at_that_level_promise(solved: TwoFingers) -> None:
    solver = EntrySolver(assemble(small()))  # for the levels of the device, 20 dB among them
    at = small().levels_db.index(20.0)
    for felt, quiet in finger_pairs(small()):
        states = [ZoneState.FREE] * 3
        states[felt], states[quiet] = ZoneState.FELT, ZoneState.QUIET
        entry = solver.solve(tuple(states))[at]
        assert solved.contrast_db[felt, quiet] == pytest.approx(entry.expected_contrast_db, abs=SEARCH_DB)
        assert solved.level_db[felt, quiet] == pytest.approx(20.0)
    assert solved.is_reached and solved.worst_db == np.nanmin(solved.contrast_db)


def test_every_two_zones_are_a_pair_both_ways_round(solved: TwoFingers) -> None:
    assert sorted(finger_pairs(small())) == [(0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)]
    assert np.isnan(np.diag(solved.contrast_db)).all() and np.isfinite(solved.contrast_db).sum() == 6


@pytest.mark.parametrize("name", first_quick(["reference-a", "reference-d", "reference-t"]))
def test_the_screening_never_gives_more_than_the_search(name: str) -> None:
    device = small(name)
    screened = screen_two_fingers(device, sample_fingers(device), 20.0, 4.0)
    found = solve_two_fingers(device, 20.0)
    assert (np.nan_to_num(screened.contrast_db - found.contrast_db) < SEARCH_DB).all()
    assert screened.is_reached == found.is_reached
    assert screened.worst_db > found.worst_db - 3.0, "or it would screen nothing"


def test_a_level_out_of_reach_ranks_below_every_one_that_is_reached(solved: TwoFingers) -> None:
    weak = with_actuators(small(), full_scale_m=1e-8)
    screened = screen_two_fingers(weak, sample_fingers(weak), 20.0, 4.0)
    assert not screened.is_reached
    assert screened.rank < solved.rank
    assert np.nanmin(screened.contrast_db) > -60.0, "of the loudest drive"
    weaker = with_actuators(weak, full_scale_m=5e-9)
    assert screen_two_fingers(weaker, sample_fingers(weaker), 20.0, 4.0).rank < screened.rank
    least_db = float(np.nanmin(solve_two_fingers(weak, 20.0).level_db))
    second_tone_db = 10 * np.log10(2)
    assert least_db - second_tone_db - SEARCH_DB < np.nanmin(screened.level_db) < least_db + SEARCH_DB
