"""The interval of a threshold holds the truth of observers with lapses, fatigue and bias."""

import pytest

from tests.studies.trust.observer import recover


@pytest.mark.long
def test_thresholds_are_recovered_within_their_intervals() -> None:
    """Of 40 runs 34 or fewer would be held with a chance of 1 in 100 if 95 % were true."""
    found = recover("all of them", 40)
    assert found.held >= 35 and found.half_db < 5 and abs(found.mean_db) < 1
