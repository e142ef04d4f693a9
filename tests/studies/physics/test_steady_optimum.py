"""Drives whose level needs full scale are the best that a patient search finds."""

import numpy as np
import pytest

from tests.studies.physics.steady_optimum import device_of, gaps_db


@pytest.mark.long
def test_few_drives_stay_below_a_patient_search() -> None:
    """Over all bars together: 25 placements tell a share of 90 % from one of 70 % as 12 of each bar did."""
    names = ("reference-a", "reference-t", "random-20230247606-3", "random-3-4", "reference-p")
    gap_db = np.array([gap_db for name in names for *_, gap_db, _s in gaps_db(device_of(name), 5, seed=2)])
    assert len(gap_db) >= 20 and (gap_db <= 0.1).mean() >= 0.9
    assert gap_db.max() < 3.0  # dB; 33.5 before the level was kept by a dual
