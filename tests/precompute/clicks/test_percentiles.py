"""Laws of percentiles over many plants: exact where courses are linear, plain where there are too few plants."""

import numpy as np
import pytest

from base.arrays import Array, Single
from precompute.clicks.percentiles import ManyPlants, percentiles

PERCENTS = (5, 50, 95)
PARAMETERS = 5


def linear_plants(count: int, seed: int) -> tuple[Array, Single, Array]:
    """Deviations (plant, parameter), courses (plant, finger, time) linear in them, and the strongest finger's peak."""
    slope = np.random.default_rng(0).normal(size=(1 + PARAMETERS, 2 * 30))
    deviation = np.random.default_rng(seed).normal(size=(count, PARAMETERS))
    course = (np.column_stack([np.ones(count), deviation]) @ slope).reshape(count, 2, 30)
    return deviation, course.astype(np.float32), abs(course).max(axis=(1, 2))


def test_where_courses_are_linear_the_percentiles_of_the_few_are_those_of_the_many() -> None:
    few, course, peak = linear_plants(12, seed=1)
    many, _, all_peaks = linear_plants(400, seed=2)
    plants = ManyPlants(few, many)
    found = plants.percentiles(course, peak, PERCENTS)
    assert found == pytest.approx(np.percentile(all_peaks, PERCENTS), rel=1e-4)
    assert plants.percentiles(course, 1.1 * peak, PERCENTS) == pytest.approx(1.1 * found)  # peaks known better scale it
    assert found != pytest.approx(np.percentile(peak, PERCENTS), rel=0.02)


@pytest.mark.parametrize("count", [1, 2, 20, 161])
def test_plain_percentiles_are_those_of_numpy(count: int) -> None:
    value, percents = np.random.default_rng(count).normal(size=count), (0, 5, 50, 95, 100)
    assert percentiles(value, percents) == pytest.approx(np.percentile(value, percents))
