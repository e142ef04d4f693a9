"""The command `tactable study`: pictures, data and summaries, and how it refuses."""

from pathlib import Path

import pytest

from engine.device import Device
from precompute.studies import robustness
from tests.precompute.devices import reference_text
from tests.tactable.cli.in_process import run_here, summary_of


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """With bar.toml, of two zones."""
    text = reference_text({"count = 5": "count = 2", 'step = "1 Hz"': 'step = "20 Hz"'})
    (tmp_path / "bar.toml").write_text(text, encoding="utf-8")
    return tmp_path


@pytest.mark.long
def test_a_placement_comes_with_its_data_and_a_summary(folder: Path) -> None:
    words = ("placement", "bar.toml", "--actuators", "2", "--most", "6", "--workers", "1")
    summary = summary_of(folder, "study", *words, "-o", "p.svg", "-o", "p.csv")
    (search,) = summary["searches"]
    own = next(each for each in search["judged"] if each["placement"] == "as described")
    assert own["position_percent"] == pytest.approx([16.0, 97.7])
    assert own["worst_contrast_db"] == pytest.approx(min(own["contrast_db"][0][1], own["contrast_db"][1][0]))
    assert (folder / "p.svg").stat().st_size > 10_000
    assert summary["written"] == ["reference-a-2-placed.toml"]
    written = Device.read(folder / "reference-a-2-placed.toml")
    length_m = written.bar.length_m
    best_percent = search["judged"][0]["position_percent"]
    assert [100 * a.position_m / length_m for a in written.actuators] == pytest.approx(best_percent, abs=1e-3)
    assert len((folder / "p.csv").read_text(encoding="utf-8").splitlines()) == 1 + 3 + search["screened"]


def test_it_says_how_much_was_looked_at_and_what_was_not(folder: Path) -> None:
    words = ("placement", "bar.toml", "--actuators", "1", "--most", "3", "--workers", "1")
    done = run_here(folder, "study", *words)
    assert "written: placement.png" in done.stdout
    assert "looked at" in done.stderr and "not at states of more fingers, at clicks" in done.stderr


def test_clicks_are_made_for_each_set_of_spreads_and_judged_on_every_change(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0})  # no other process
    monkeypatch.setattr(robustness, "PLACEMENTS", 2)
    words = ("robustness", "bar.toml", "--plants", "4", "-o", "r.png", "-o", "r.csv")
    summary = summary_of(folder, "study", *words)
    rows = [(row["made_for"], row["different"]) for row in summary["rows"]]
    assert rows == [(name, change.name) for name in ("bench", "lab", "hand") for change in robustness.CHANGES]
    assert len({row["contrast_db"] for row in summary["rows"]}) > 0.9 * len(rows)
    assert all(0 <= row["faint"] <= row["clear"] <= 1 for row in summary["rows"])
    assert len((folder / "r.csv").read_text(encoding="utf-8").splitlines()) == 1 + len(rows)
    assert (folder / "r.png").read_bytes().startswith(b"\x89PNG")
