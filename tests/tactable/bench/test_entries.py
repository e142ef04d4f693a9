"""The benchmarks of states and of contrast: what they print can be checked by hand."""

from dataclasses import replace
from pathlib import Path

import pytest

from engine.device import Device
from engine.table import Table
from precompute.builder.build import build_table
from tactable.bench.entries import run_contrast_bench, run_states_bench
from tests.precompute.devices import SHIPPED, shipped, with_zones


def test_states_are_counted_and_timed() -> None:
    device = replace(with_zones(shipped("reference-a"), 2), levels_db=(20.0,))
    result = run_states_bench(device)
    assert result["device"]["states"] == result["device"]["solved"] == 5  # 3^n - 2^n
    assert result["device"]["all_states_s"] > 0
    assert result["slsqp_ratio"] > 0


def test_contrast_in_time_is_the_contrast_in_frequency(tmp_path: Path) -> None:
    text = (SHIPPED / "reference-a.toml").read_text(encoding="utf-8")
    device = Device.parse(text.replace("count = 5", "count = 2").replace('step = "1 Hz"', 'step = "8 Hz"'), "two zones")
    build_table(device, tmp_path / "bar.nc", created="2026-01-01", clicks_up_to=0)
    with Table.open(tmp_path / "bar.nc") as table:
        result = run_contrast_bench(table, 10.0)
    assert [(row["felt"], row["quiet"]) for row in result["states"]] == [("I", "II"), ("II", "I")]
    for row in result["states"]:
        for who in ("paper", "ours"):
            assert row[who]["time_domain_contrast_db"] == pytest.approx(row[who]["contrast_db"], abs=0.05)
        assert row["ours"]["expected_contrast_db"] > row["paper"]["expected_contrast_db"]
