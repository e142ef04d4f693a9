"""The command `tactable plot`: pictures, data and summaries of it, and how it refuses."""

import json
import math
import sys
from pathlib import Path
from typing import Any

import pytest

from tactable.cli.main import main
from tests.tactable.plot_table import build_small_table

FIGURES = {
    "state": ("state", "bar.nc", "--felt", "I", "--quiet", "III"),
    "state-at-positions": ("state", "bar.nc", "--felt", "35 mm", "--quiet", "120 mm,160mm"),
    "course-at-positions": ("rise", "bar.nc", "--felt", "35 mm"),
    "course": ("rise", "bar.nc", "--felt", "I", "--quiet", "III"),
    "factor": ("factor", "bar.nc", "--zones", "I,III", "--fingers", "II", "--amplitudes", "1,0.4"),
}


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_small_table(tmp_path_factory.mktemp("built")).parent


@pytest.fixture
def tactable_plot(built: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Run `tactable plot` with these words in the folder of the table; its exit status."""

    def run(*words: str) -> int:
        monkeypatch.chdir(built)
        monkeypatch.setattr(sys, "argv", ["tactable", "plot", *words])
        with pytest.raises(SystemExit) as end:
            main()
        return int(end.value.code or 0)

    return run


def strict_json(text: str) -> Any:
    """JSON without what only Python reads: NaN and Infinity."""
    return json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))


@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_comes_with_its_data_and_a_summary(
    built: Path, tactable_plot: Any, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    picture = f"{FIGURES[name][0]}.png"
    (built / picture).unlink(missing_ok=True)
    assert tactable_plot(*FIGURES[name], "-o", picture, "-o", f"{name}.csv", "--json") == 0
    summary = strict_json(capsys.readouterr().out)
    assert summary["figure"] == picture
    assert summary["csv"] == f"{name}.csv"
    assert summary["device"] == "reference-a"
    assert (built / picture).read_bytes().startswith(b"\x89PNG")
    assert len((built / f"{name}.csv").read_text(encoding="utf-8").splitlines()) > 9


def test_a_picture_goes_where_it_is_wanted_and_a_line_says_what_it_shows(
    built: Path, tactable_plot: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    assert tactable_plot(*FIGURES["course"], "-o", "wanted.svg") == 0
    caption, written = capsys.readouterr().out.splitlines()
    assert caption.startswith("reference-a")
    assert written == "written: wanted.svg"
    assert (built / "wanted.svg").stat().st_size > 10_000


def test_without_zones_the_factor_of_each_is_drawn(tactable_plot: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert tactable_plot("factor", "bar.nc", "--json") == 0
    summary = strict_json(capsys.readouterr().out)
    assert summary["zones"] == [["I"], ["II"], ["III"]] and len(summary["greatest"]) == 3


def test_a_level_that_full_scale_stands_for_is_null_in_json(
    tactable_plot: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("state", "bar.nc", "--felt", "I", "--level", "inf", "-o", "full.png", "--json")
    assert tactable_plot(*words) == 0
    summary = strict_json(capsys.readouterr().out)
    assert summary["wanted_level_db"] is None
    assert math.isfinite(summary["level_db"])
    assert summary["quiet"] == []
    assert [finger["zone"] for finger in summary["fingers"]] == ["I"]


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (("state", "missing.nc", "--felt", "I"), ("missing.nc", "tactable build")),
        (("state", "bar.nc", "--felt", "VI"), ("'VI'", "I, II, III")),
        (("state", "bar.nc", "--felt", ","), ("--felt names no zone",)),
        (("state", "bar.nc", "--felt", "I", "--quiet", "I"), ("46.5667 mm", "one finger")),
        (("state", "bar.nc", "--felt", "I", "--level", "nan"), ("--level 'nan'",)),
        (("state", "bar.nc", "--felt", "I", "-o", "state.gif"), ("state.gif", ".png, .svg, .pdf")),
        (("state", "bar.nc", "--felt", "I", "-o", "bar.nc"), ("bar.nc", ".csv")),
        (("state", "bar.nc", "--felt", "I", "-o", "nowhere/state.png"), ("nowhere", "no such folder")),
        (("rise", "bar.nc", "--felt", "I", "--level", "nan"), ("--level 'nan'",)),
        (("factor", "bar.nc", "--zones", ","), ("--zones names no zone",)),
        (("factor", "bar.nc", "--zones", "I", "--amplitudes", "1,high"), ("--amplitudes '1,high'",)),
        (("factor", "bar.nc", "--zones", "I", "--amplitudes", "1,0.5"), ("'1,0.5'", "0.4")),
        (("factor", "bar.nc", "--zones", "I", "--pair", "up,down"), ("'up,down'", "left,right")),
        (("factor", "bar.nc", "--zones", "I", "--fingers", "IX"), ("'IX'", "I, II, III")),
    ],
)
def test_a_refusal_is_one_line_naming_the_thing(
    tactable_plot: Any, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], parts: tuple[str, ...]
) -> None:
    assert tactable_plot(*words) == 1
    said = capsys.readouterr().err
    assert said.startswith("tactable: ")
    assert said.count("\n") == 1
    for part in parts:
        assert part in said
