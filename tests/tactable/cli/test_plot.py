"""The commands of pictures and studies: each comes with its data and a summary."""

import math
from pathlib import Path

import pytest

from engine.device import Device
from precompute.studies import robustness
from tests.precompute.builder.test_table_build import SMALL
from tests.precompute.devices import reference_text
from tests.tactable.cli.in_process import run_here, summary_of

CLICK = ("click", "bar.nc", "--felt", "I", "--quiet", "III")
PICTURES = {
    "state": ("state", "bar.nc", "--felt", "I", "--quiet", "III"),
    "rise": ("state", "bar.nc", "--felt", "I", "--quiet", "III", "--over-time"),
    "rise-at-positions": ("state", "bar.nc", "--felt", "35 mm", "--over-time"),
    "factor": ("factor", "bar.nc", "--zones", "I,III", "--amplitudes", "1,0.5"),
    "click": CLICK,
    "response": ("response", "reference-a", "--drives", "-,140;-,200;-,230"),
    "zones": ("response", "reference-a", "--by-zone", "--drives", "60,90", "--change", "bar.mass_damping=0 1/s"),
    "optimum": ("optimum", "bar.toml", "--zones", "I,III"),
    "reach": ("reach", "bar.toml"),
}


@pytest.fixture(scope="module")
def folder(click_table: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pictures")
    (folder / "bar.toml").write_text(SMALL, encoding="utf-8")
    (folder / "bar.nc").hardlink_to(click_table)
    return folder


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_comes_with_its_data_and_a_summary(folder: Path, name: str) -> None:
    picture = folder / f"{name}.png"
    summary = summary_of(folder, "plot", *PICTURES[name], "-o", picture.name, "-o", f"{name}.csv")
    assert (summary["figure"], summary["csv"]) == (picture.name, f"{name}.csv")
    assert summary["device"].startswith("reference-")
    assert summary["device"].endswith(", changed") == (name == "zones")
    if "click" in name:
        assert "detection threshold" in summary["estimated"]
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert len((folder / f"{name}.csv").read_text(encoding="utf-8").splitlines()) > 3


def test_a_level_that_full_scale_stands_for_is_null_in_json(folder: Path) -> None:
    summary = summary_of(folder, "plot", "state", "bar.nc", "--felt", "I", "--level", "inf", "-o", "full.png")
    assert summary["wanted_level_db"] is None
    assert math.isfinite(summary["level_db"])
    assert summary["quiet"] == []
    assert [finger["zone"] for finger in summary["fingers"]] == ["I"]


@pytest.fixture
def studied(tmp_path: Path) -> Path:
    """With bar.toml, of two zones."""
    text = reference_text({"count = 5": "count = 2", 'step = "1 Hz"': 'step = "20 Hz"'})
    (tmp_path / "bar.toml").write_text(text, encoding="utf-8")
    return tmp_path


@pytest.mark.long
def test_a_placement_comes_with_its_data_and_a_summary(studied: Path) -> None:
    words = ("placement", "bar.toml", "--actuators", "2", "--most", "6", "--workers", "1")
    summary = summary_of(studied, "study", *words, "-o", "p.svg", "-o", "p.csv")
    (search,) = summary["searches"]
    own = next(each for each in search["judged"] if each["placement"] == "as described")
    assert own["position_percent"] == pytest.approx([16.0, 97.7])
    assert own["worst_contrast_db"] == pytest.approx(min(own["contrast_db"][0][1], own["contrast_db"][1][0]))
    assert (studied / "p.svg").stat().st_size > 10_000
    assert summary["written"] == ["reference-a-2-placed.toml"]
    written = Device.read(studied / "reference-a-2-placed.toml")
    length_m = written.bar.length_m
    best_percent = search["judged"][0]["position_percent"]
    assert [100 * a.position_m / length_m for a in written.actuators] == pytest.approx(best_percent, abs=1e-3)
    assert len((studied / "p.csv").read_text(encoding="utf-8").splitlines()) == 1 + 3 + search["screened"]


def test_it_says_how_much_was_looked_at_and_what_was_not(studied: Path) -> None:
    words = ("placement", "bar.toml", "--actuators", "1", "--most", "3", "--workers", "1")
    done = run_here(studied, "study", *words)
    assert "written: placement.png" in done.stdout
    assert "looked at" in done.stderr and "not at states of more fingers, at clicks" in done.stderr


def test_clicks_are_made_for_each_set_of_spreads_and_judged_on_every_change(
    studied: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0})  # no other process
    monkeypatch.setattr(robustness, "PLACEMENTS", 2)
    words = ("robustness", "bar.toml", "--plants", "4", "-o", "r.png", "-o", "r.csv")
    summary = summary_of(studied, "study", *words)
    rows = [(row["made_for"], row["different"]) for row in summary["rows"]]
    assert rows == [(name, change.name) for name in ("bench", "lab", "hand") for change in robustness.CHANGES]
    assert len({row["contrast_db"] for row in summary["rows"]}) > 0.9 * len(rows)
    assert all(0 <= row["faint"] <= row["clear"] <= 1 for row in summary["rows"])
    assert len((studied / "r.csv").read_text(encoding="utf-8").splitlines()) == 1 + len(rows)
    assert (studied / "r.png").read_bytes().startswith(b"\x89PNG")
