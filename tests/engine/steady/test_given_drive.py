"""Levels of a given drive beside those of finite elements, and the laws of its tones."""

import numpy as np
import pytest

from engine.steady.given_drive import CASES, compute_levels
from precompute.predict.at_positions import SAMPLES
from tests.engine.steady.solvers import DEVICES, designer_of

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
