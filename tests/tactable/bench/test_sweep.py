"""The benchmark of the sweep: its time stands beside that of the floor."""

import io
import json

import pytest
from rich.console import Console

from tactable.bench.sweep import print_sweep_bench, run_sweep_bench
from tactable.shipped import find_device


def test_the_sweep_is_timed_beside_the_time_to_write_its_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tactable.bench.sweep.ROUNDS", 1)
    result = run_sweep_bench(find_device("reference-a"))
    json.dumps(result, allow_nan=False)
    assert result["times_the_floor"] == result["sweep_s"] / result["memory_floor_s"] > 0
    page = io.StringIO()
    print_sweep_bench(Console(file=page, width=120), result)
    assert "floor" in page.getvalue()
