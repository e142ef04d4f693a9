"""The study of growth counts states, times them and draws them."""

from dataclasses import replace
from pathlib import Path

from tests.precompute.clicks.click_cases import CHEAP
from tests.precompute.devices import shipped, with_zones
from tests.studies.cost.growth import draw, exponents_of, measure_clicks, measure_entries

DEVICE = with_zones(shipped("reference-a"), 3)
COARSE = replace(DEVICE, sweep=replace(DEVICE.sweep, step_hz=8.0), levels_db=(20.0,))


def test_entries_of_every_number_of_zones_and_actuators_are_timed() -> None:
    rows = measure_entries(COARSE, (1, 2), (1, 2))
    assert [row["states"] for row in rows] == [1, 5, 1, 5]  # 3^n - 2^n
    assert all(row["all_states_s"] > 0 for row in rows)
    assert set(exponents_of(rows)) == {"1 actuators", "2 actuators"}


def test_clicks_are_timed_in_processes_of_their_own_and_drawn(tmp_path: Path) -> None:
    rows = measure_clicks(COARSE, replace(CHEAP, scenarios=4), (("zones", 2), ("zones", 3), ("length_ms", 10)))
    assert [(row["series"], row["value"], row["states"]) for row in rows] == [
        ("zones", 2, 5),
        ("zones", 3, 19),
        ("length_ms", 10, 19),
    ]
    assert all(row["all_states_s"] > 0 and row["memory_mib"] > 10 for row in rows)
    found = exponents_of(rows)
    assert set(found) == {"zones"} and found["zones"] > 0
    draw(rows, "SIMULATED", tmp_path / "growth.png")
    assert (tmp_path / "growth.png").stat().st_size > 1000
