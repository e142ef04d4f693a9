"""The command `verify` on a simulated bench: a bar that the table describes keeps the promise, another does not."""

import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from engine.table import Table
from engine.table.best_rows import write_best_rows
from engine.table.netcdf_file import TableWriter
from tactable.measure import verification
from tests.engine.made_states import rows_of
from tests.tactable.cli.in_process import run_here

SIMULATED = ("--port", "simulated", "--sensor", "simulated", "--places", "1", "--placements", "2")


@pytest.fixture(autouse=True, scope="module")
def bars_once() -> Iterator[None]:
    """The bars that a table holds for possible are the same each time that it is verified."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(verification, "PossibleSurfaces", cache(verification.PossibleSurfaces))
        yield


def verified(folder: Path, table: Path, *words: str, exit_status: int) -> dict[str, Any]:
    done = run_here(folder, "verify", str(table), *SIMULATED, *words, "--json")
    assert done.returncode == exit_status, done.stderr
    summary = json.loads(done.stdout)
    assert isinstance(summary, dict) and summary["simulated"]
    return summary


def test_the_bar_of_a_table_keeps_its_promise_in_drives_and_clicks_whatever_offset_and_sign_of_the_sensor_are(
    tmp_path: Path, click_table: Path
) -> None:
    flaws = "drift=40,offset=50m/s^2,gain=-200%"
    summary = verified(tmp_path, click_table, "-o", "seen.png", "-o", "seen.csv", "--flaws", flaws, exit_status=0)
    assert (summary["verdict"], summary["kept"]) == ("kept", 4)
    assert summary["faults"] == {"CLOCK_DRIFT": 2, "OFFSET": 4}
    assert sorted(point["kind"] for point in summary["points"]) == ["click", "click", "drive", "drive"]
    for point in summary["points"]:
        assert point["low_m_per_s2"] < point["promised_m_per_s2"] < point["high_m_per_s2"]
        assert abs(point["difference_db"]) < (0.1 if point["kind"] == "drive" else 0.5)
    assert (tmp_path / "seen.png").stat().st_size > 10_000
    assert len((tmp_path / "seen.csv").read_text(encoding="utf-8").splitlines()) == 5


def with_rows(click_table: Path, path: Path) -> Path:
    with Table.open(click_table) as table, TableWriter(path) as writer:
        kept = {key: value for key, value in table.attributes.items() if not key.startswith(("_", "format"))}
        writer.describe({key: value.item() if hasattr(value, "item") else value for key, value in kept.items()})
        table.copy_groups(writer, ["responses", "modes", "entries", "clicks"])
        write_best_rows(writer, rows_of(table.device), table.device)
    return path


@pytest.mark.parametrize("tones", [1, 2])
def test_the_bar_of_a_table_keeps_what_rows_of_the_sweep_promise(tmp_path: Path, click_table: Path, tones: int) -> None:
    path = click_table if tones == 1 else with_rows(click_table, tmp_path / "two.nc")
    summary = verified(tmp_path, path, "--drives", "zones", exit_status=0)
    assert (summary["verdict"], summary["kept"]) == ("kept", 2)
    assert all(point["kind"] == "drive" and abs(point["difference_db"]) < 0.1 for point in summary["points"])


def test_another_bar_is_beyond_the_promise_and_the_exit_status(tmp_path: Path, click_table: Path) -> None:
    done = run_here(tmp_path, "verify", str(click_table), *SIMULATED, "--change", "actuator.full_scale=0.8 µm")
    assert done.returncode == 3, done.stderr
    assert "4 break it" in done.stdout and "the bar does not keep the promise" in done.stdout
    assert "measure the bar and calibrate" in done.stderr
