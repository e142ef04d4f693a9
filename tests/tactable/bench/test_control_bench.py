"""The control bench: every touch and every message has its time, and the two stand beside each other."""

import io
import json
from pathlib import Path

import pytest
from rich.console import Console

from engine.table import Table
from tactable.bench.control_bench import print_control_bench, run_control_bench
from tactable.shipped import find_device
from tests.engine.made_clicks import every_click
from tests.engine.made_table import write_table

ROUNDS = 10
DEVICE = find_device("reference-a")


@pytest.mark.machine
def test_each_round_times_a_touch_and_a_message_in_the_same_run(tmp_path: Path) -> None:
    path = write_table(tmp_path / "bar.nc", DEVICE, every_click(DEVICE))
    with Table.open(path, verify=False) as table:
        result = run_control_bench(table, ROUNDS)
    json.dumps(result, allow_nan=False)
    for row in result["rows"]:
        assert row["control_steps"] == row["answer"]["count"] == ROUNDS
        assert row["touch"]["count"] + row["message"]["count"] + row["without_a_command"] == 2 * ROUNDS
        assert row["ratio_p50"] == row["message"]["p50_us"] / row["touch"]["p50_us"]
        assert row["ratio_p99"] is None  # ten samples have no 99th percentile
        assert row["mispredicted"] == 0
    assert result["rows"][1]["answered_by_compiled_step"] == 0
    shown = io.StringIO()
    print_control_bench(Console(file=shown, width=160), result)
    assert "the Python loop" in shown.getvalue()
