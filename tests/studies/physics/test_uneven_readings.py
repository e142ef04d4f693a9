"""The study of uneven readings: intervals hold where readings differ in quality, and even ones would not."""

import pytest

from tests.studies.physics.uneven_readings import measure_coverage


@pytest.mark.long
def test_intervals_of_uneven_readings_hold_and_those_that_take_them_as_even_are_narrower() -> None:
    found = measure_coverage(12)
    assert found.held.mean() >= 0.93
    assert found.held_even.sum() < found.held.sum()
