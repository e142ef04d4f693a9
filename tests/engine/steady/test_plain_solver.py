"""Steady drives and levels in NumPy beside those of the compiled solver and of finite elements."""

import numpy as np
import pytest

from engine.steady.plain_solver import PlainSolver
from engine.steady.steady_drive import CASES, compute_levels
from precompute.predict.at_positions import SAMPLES
from tests.engine.steady.bound import DEVICES, designer_of

MOST_LOST_DB, MEDIAN_LOST_DB = 4.0, 1.0
"""Of the expected contrast, or of the level where the loudest drive is asked for."""
ENOUGH_DB = 25.0
"""With it a finger beside one at 20 dB is 5 dB below the threshold: more is not felt."""


@pytest.mark.parametrize("name", ["reference-a", "reference-t"])
def test_drives_are_nearly_as_good_as_those_of_the_compiled_solver(name: str) -> None:
    device = DEVICES[name]
    exact, random, lost_db = designer_of(device).solver, np.random.default_rng(7), list[float]()
    plain = PlainSolver(device, designer_of(device).modes)
    for fingers in (2, 2, 2, 2, 3, 3, 4):
        position_m = (np.arange(fingers) + random.uniform(0.2, 0.8, fingers)) * device.bar.length_m / fingers
        felt = [finger != fingers - 1 if fingers == 4 else finger == 0 for finger in range(fingers)]
        best, found = (each.solve(position_m.tolist(), felt, 20.0) for each in (exact, plain))
        assert (found.objective, found.achieved) == (best.objective, best.achieved)
        assert found.weakest_felt_db == pytest.approx(20.0, abs=1e-6)
        assert found.expected_contrast_db is not None and best.expected_contrast_db is not None
        lost_db.append(min(best.expected_contrast_db, ENOUGH_DB) - found.expected_contrast_db)
    assert max(lost_db) < MOST_LOST_DB
    assert np.median(lost_db) < MEDIAN_LOST_DB


def test_a_level_out_of_reach_and_full_scale_are_answered_by_the_loudest_drive() -> None:
    device = DEVICES["reference-t"]
    exact, plain = designer_of(device).solver, PlainSolver(device, designer_of(device).modes)
    for felt in ([True, False], [True, True]):
        for level_db in (np.inf, 90.0):
            best, found = (each.solve([0.06, 0.21], felt, level_db) for each in (exact, plain))
            assert (found.objective, found.achieved) == ("level", best.achieved)
            assert max(found.amplitudes) == pytest.approx(device.limits.amplitude)
            assert found.weakest_felt_db > best.weakest_felt_db - MOST_LOST_DB


def test_an_actuator_is_still_outside_its_band() -> None:
    device = DEVICES["reference-a"].with_values({"actuator[1].band": ["60 Hz", "120 Hz"]})
    plain = PlainSolver(device, designer_of(DEVICES["reference-a"]).modes)
    for position_m in ([0.03, 0.2], [0.1, 0.25]):
        drive = plain.solve(position_m, [True, False], 20.0)
        assert drive.frequency_hz <= 120.0 or drive.amplitudes[0] == 0.0


POSITIONS_M, ROLES = (0.035, 0.12, 0.15), (True, False, False)
PERCENTS = (5, 50, 95)


@pytest.mark.parametrize("name", ["reference-a", "three actuators"])
def test_levels_and_their_spread_are_those_of_finite_elements(name: str) -> None:
    device = DEVICES[name]
    designer = designer_of(device)
    figures = designer.solve(POSITIONS_M, ROLES, 20.0)
    drive = figures.drive
    found_db = compute_levels(device, designer.modes, POSITIONS_M, drive.frequencies_hz, drive.complex_amplitudes)
    assert found_db.shape == (1 + CASES, len(POSITIONS_M)) and CASES == SAMPLES
    assert found_db[0] == pytest.approx(figures.level_db, abs=0.1)
    assert np.percentile(found_db[1:], PERCENTS, axis=0) == pytest.approx(
        np.percentile(figures.sampled_level_db, PERCENTS, axis=0), abs=0.2
    )
