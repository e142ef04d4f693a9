"""The studies of calibrations: figures of every case and a picture; intervals hold where readings differ in quality."""

from functools import cache
from pathlib import Path
from typing import Any

import pytest

from tests.precompute.measured import TRUTH
from tests.studies.physics import uneven_readings
from tests.studies.physics.calibration_coverage import Case, describe, draw, measure_coverage

pytestmark = pytest.mark.long


@cache
def result() -> dict[str, Any]:
    return measure_coverage((Case("reference-a", 3, 0.01), Case("reference-a", 3, 0.0, published=True)), 1)


def test_every_case_has_its_figures() -> None:
    noisy, clean = result()["cases"]
    assert [p["name"] for p in noisy["parameters"]] == list(TRUTH)
    assert max(p["greatest_error"] for p in clean["parameters"] if p["name"] != "bar.mass_damping") < 1e-6
    assert 0 <= noisy["held"] <= 1
    assert noisy["seconds"]["greatest"] >= noisy["seconds"]["median"] > 0


def test_the_study_is_described_and_drawn(tmp_path: Path) -> None:
    assert [("as published" in describe(row)) for row in result()["cases"]] == [False, True]
    draw(result(), tmp_path / "held.png")
    assert (tmp_path / "held.png").stat().st_size > 10_000


def test_intervals_of_uneven_readings_hold_and_those_that_take_them_as_even_are_narrower() -> None:
    held, held_even = uneven_readings.measure_coverage(12)
    assert held.mean() >= 0.93
    assert held_even.sum() < held.sum()
