"""The commands of figures without a table: pictures, data and summaries, and how they refuse."""

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from tactable.cli.main import main
from tactable.shipped import device_folder

MEASURED = device_folder().parent / "measurements" / "reference-a-drifted.csv"
FIGURE_3 = tuple(
    word
    for change in (
        "actuator.stiffness=20 kN/m",
        "actuator.damping=0.0265 N*s/m",
        "actuator.full_scale=0.42 µm",
        "bar.mass_damping=0 1/s",
        "bar.stiffness_damping=0 s",
    )
    for word in ("--change", change)
)
WORDS = {
    "response": ("response", "reference-a", "--drives", "-,140;-,200;-,230"),
    "measured": ("response", "reference-a", "--measured", str(MEASURED)),
    "zones": ("zones", "reference-a", "--drives", "60,90", *FIGURE_3),
    "optimum": ("optimum", "reference-a", "--zones", "I,III,V"),
    "reach": ("reach", "reference-d"),
}


@pytest.fixture
def tactable_plot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Run `tactable plot` with these words in an empty folder; its exit status."""

    def run(*words: str) -> int:
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", ["tactable", "plot", *words])
        with pytest.raises(SystemExit) as end:
            main()
        return int(end.value.code or 0)

    return run


@pytest.mark.parametrize("name", WORDS)
def test_a_figure_comes_with_its_data_and_a_summary(
    tmp_path: Path, tactable_plot: Any, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    picture = f"{WORDS[name][0]}.png"
    assert tactable_plot(*WORDS[name], "-o", picture, "-o", f"{name}.csv", "--json") == 0
    summary = json.loads(capsys.readouterr().out, parse_constant=lambda word: pytest.fail(f"{word} is no JSON"))
    assert (summary["figure"], summary["csv"]) == (picture, f"{name}.csv")
    assert summary["device"].startswith("reference-")
    assert summary["device"].endswith(", changed") == (name == "zones")
    assert (tmp_path / picture).read_bytes().startswith(b"\x89PNG")
    assert len((tmp_path / f"{name}.csv").read_text(encoding="utf-8").splitlines()) > 5


def test_a_picture_goes_where_it_is_wanted_and_a_line_says_what_it_shows(
    tmp_path: Path, tactable_plot: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    assert tactable_plot(*WORDS["zones"], "-o", "wanted.svg") == 0
    caption, written = capsys.readouterr().out.splitlines()
    assert caption.startswith("reference-")
    assert written == "written: wanted.svg"
    assert (tmp_path / "wanted.svg").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (("response", "reference-a"), ("--drives", "--measured FILE")),
        (("response", "reference-a", "--drives", "1,2", "--measured", "x.csv"), ("--drives", "which has its own")),
        (("response", "reference-a", "--drives", "150"), ("--drives '150'", "left,right")),
        (("response", "reference-a", "--measured", "none.csv"), ("none.csv",)),
        (("response", "reference-a", "--measured", "none.txt"), ("none.txt", ".csv")),
        (("response", "no-such-bar", "--drives", "1,2"), ("no-such-bar", "reference-a")),
        (("zones", "reference-a", "--drives", "60,90", "--change", "bar.colour=1"), ("bar.colour",)),
        (("zones", "reference-a", "--drives", "1,2;1,3;1,4;1,5;1,6"), ("5 drives", "one to 4")),
        (("optimum", "reference-a", "--zones", "VI"), ("'VI'", "I, II, III")),
        (("optimum", "reference-a", "--zones", ","), ("--zones names no zone",)),
        (("reach", "reference-a", "-o", "reach.gif"), ("reach.gif", ".png, .svg, .pdf")),
        (("reach", "reference-a", "-o", "nowhere/reach.csv"), ("nowhere", "no such folder")),
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
