"""The commands of pictures: each comes with its data and a summary; sounds beside clicks."""

import math
from pathlib import Path

import pytest

from tests.precompute.builder.test_table_build import SMALL
from tests.tactable.cli.in_process import summary_of

CLICK = ("click", "bar.nc", "--felt", "I", "--quiet", "III")
PICTURES = {
    "state": ("state", "bar.nc", "--felt", "I", "--quiet", "III"),
    "rise": ("state", "bar.nc", "--felt", "I", "--quiet", "III", "--over-time"),
    "rise-at-positions": ("state", "bar.nc", "--felt", "35 mm", "--over-time"),
    "factor": ("factor", "bar.nc", "--zones", "I,III", "--fingers", "II", "--amplitudes", "1,0.5"),
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
