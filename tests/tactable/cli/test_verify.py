"""The command `verify` on a simulated bench: a bar that the table describes keeps the promise, another does not."""

import json
from pathlib import Path

import pytest

from engine.table import Table
from engine.table.best_rows import write_best_rows
from engine.table.file import TableWriter
from engine.touch import Placement
from tactable.measure.faults import Fault
from tactable.measure.verify import Played, Point, verdict_of
from tests.engine.made_rows import rows_of
from tests.tactable.cli.in_process import run_here

SIMULATED = ("--port", "simulated", "--sensor", "simulated", "--places", "1", "--placements", "2")


def test_the_bar_of_a_table_keeps_its_promise_in_drives_and_clicks(tmp_path: Path, click_table: Path) -> None:
    files = ("--figure", "seen.png", "--csv", "seen.csv")
    done = run_here(tmp_path, "verify", str(click_table), *SIMULATED, *files, "--flaws", "drift=40", "--json")
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert (summary["verdict"], summary["outside"], summary["compared"]) == ("kept", 0, 4)
    assert summary["simulated"]
    assert sorted(point["kind"] for point in summary["points"]) == ["click", "click", "drive", "drive"]
    for point in summary["points"]:
        assert point["low_m_per_s2"] < point["promised_m_per_s2"] < point["high_m_per_s2"]
        assert abs(point["difference_db"]) < (0.1 if point["kind"] == "drive" else 0.5)
    assert (tmp_path / "seen.png").stat().st_size > 10_000
    assert len((tmp_path / "seen.csv").read_text(encoding="utf-8").splitlines()) == 5


def with_rows(click_table: Path, path: Path) -> Path:
    """The table with rows of two frequencies."""
    with Table.open(click_table) as table, TableWriter(path) as writer:
        kept = {key: value for key, value in table.attributes.items() if not key.startswith(("_", "format"))}
        writer.describe({key: value.item() if hasattr(value, "item") else value for key, value in kept.items()})
        table.copy_groups(writer, ["responses", "receptances", "entries", "clicks"])
        write_best_rows(writer, rows_of(table.device), table.device)
    return path


@pytest.mark.parametrize("tones", [1, 2])
def test_the_bar_of_a_table_keeps_what_rows_of_the_sweep_promise(tmp_path: Path, click_table: Path, tones: int) -> None:
    path = click_table if tones == 1 else with_rows(click_table, tmp_path / "two.nc")
    done = run_here(tmp_path, "verify", str(path), *SIMULATED, "--drives", "zones", "--json")
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert (summary["verdict"], summary["compared"]) == ("kept", 2)
    assert all(point["kind"] == "drive" and abs(point["difference_db"]) < 0.1 for point in summary["points"])


def test_another_bar_is_beyond_the_promise_and_the_exit_status(tmp_path: Path, click_table: Path) -> None:
    other = ("--change", "actuator.full_scale=0.8 µm")
    done = run_here(tmp_path, "verify", str(click_table), *SIMULATED, *other)
    assert done.returncode == 3, done.stderr
    assert "4 of 4 points beyond the promised interval: the bar does not keep the promise" in done.stdout
    assert "measure the bar and calibrate" in done.stderr


def test_a_reading_that_a_fault_spoils_is_not_compared(tmp_path: Path, click_table: Path) -> None:
    done = run_here(tmp_path, "verify", str(click_table), *SIMULATED, "--flaws", "clip=0.01m/s^2", "--json")
    assert done.returncode == 3
    summary = json.loads(done.stdout)
    assert (summary["verdict"], summary["compared"]) == ("not compared", 0)
    assert all("CLIPPING" in point["faults"] for point in summary["points"])


def point_of(read_m_per_s2: float, fault: Fault | None) -> Point:
    played = Played(Placement((0.05,), (True,)), None, None)
    return Point(played, 0.1, read_m_per_s2, 1.0, 0.9, 1.1, () if fault is None else (fault,))


@pytest.mark.parametrize(
    ("spoiled", "outside", "verdict"),
    [
        (0, 0, "kept"),
        (1, 0, "kept"),
        (0, 1, "kept"),
        (2, 0, "in part"),
        (0, 2, "beyond"),
        (5, 1, "beyond"),
        (10, 0, "not compared"),
    ],
)
def test_a_promise_that_was_tested_in_part_only_is_not_called_kept(spoiled: int, outside: int, verdict: str) -> None:
    points = [point_of(1.0, Fault.CLIPPING)] * spoiled + [point_of(2.0, None)] * outside
    assert verdict_of(points + [point_of(1.0, None)] * (10 - len(points))) == verdict


@pytest.mark.parametrize(
    ("words", "text"),
    [(("--level", "loud"), "expected dB above threshold"), (("--csv", "seen.csv"), "--csv goes with --figure")],
)
def test_what_cannot_be_verified_is_refused(
    tmp_path: Path, click_table: Path, words: tuple[str, ...], text: str
) -> None:
    done = run_here(tmp_path, "verify", str(click_table), *SIMULATED, *words)
    assert done.returncode == 1
    assert text in done.stderr
