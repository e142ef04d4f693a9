"""The study of growth counts states, times them and draws them."""

from dataclasses import replace
from pathlib import Path

import pytest

from precompute.studies.zone_resolution import with_equal_zones
from tests.precompute.clicks.click_cases import CHEAP
from tests.precompute.devices import shipped
from tests.studies.cost.growth import draw, exponents_of, measure_clicks, time_clicks

DEVICE = with_equal_zones(shipped("reference-a"), 3)
COARSE = replace(DEVICE, sweep=replace(DEVICE.sweep, step_hz=8.0), levels_db=(20.0,))


@pytest.mark.long
def test_clicks_of_every_case_are_timed_and_drawn(tmp_path: Path) -> None:
    cases = (("fingers", 1), ("fingers", 2), ("actuators", 3), ("plants", 80), ("ms of click", 10), ("mm of bar", 200))
    rows = [time_clicks(COARSE, CHEAP, 2, case) for case in cases]
    assert [(row["series"], row["value"]) for row in rows] == list(cases)
    assert all(row["click_s"] > 0 and row["memory_mib"] > 10 for row in rows)
    assert set(exponents_of(rows)) == {"fingers"}
    draw(rows, "SIMULATED", tmp_path / "growth.png")
    assert (tmp_path / "growth.png").stat().st_size > 1000


@pytest.mark.machine(stall_s=None)
def test_clicks_are_timed_in_a_process_of_their_own() -> None:
    (row,) = measure_clicks(COARSE, CHEAP, [("fingers", 1)], 2)
    assert (row["series"], row["value"]) == ("fingers", 1)
