"""The commands of clicks: pictures, data, sounds and summaries of them, and how they refuse."""

import json
import sys
import wave
from pathlib import Path
from typing import Any

import pytest

from tactable.cli.main import main
from tests.precompute.builder.test_build import SMALL

WORDS = {
    "click": ("plot", "click", "bar.nc", "--felt", "I", "--quiet", "III"),
}


@pytest.fixture
def run(click_table: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Run `tactable` with these words in the folder of the table; its exit status."""
    (click_table.parent / "bar.toml").write_text(SMALL, encoding="utf-8")

    def run(*words: str) -> int:
        monkeypatch.chdir(click_table.parent)
        monkeypatch.setattr(sys, "argv", ["tactable", *words])
        with pytest.raises(SystemExit) as end:
            main()
        return int(end.value.code or 0)

    return run


def strict_json(text: str) -> Any:
    """JSON without what only Python reads: NaN and Infinity."""
    return json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))


@pytest.mark.parametrize("name", WORDS)
def test_a_figure_comes_with_its_data_and_a_summary(
    click_table: Path, run: Any, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    assert run(*WORDS[name], "-o", f"{name}.svg", "-o", f"{name}.csv", "--json") == 0
    summary = strict_json(capsys.readouterr().out)
    assert (summary["figure"], summary["csv"], summary["device"]) == (f"{name}.svg", f"{name}.csv", "reference-a")
    assert "detection threshold" in summary["estimated"]
    assert (click_table.parent / f"{name}.svg").stat().st_size > 10_000
    assert len((click_table.parent / f"{name}.csv").read_text(encoding="utf-8").splitlines()) > 3


def test_a_sound_is_written_beside_the_picture(click_table: Path, run: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(*WORDS["click"], "--sound", "click.wav") == 0
    sound, caption, picture = capsys.readouterr().out.splitlines()
    assert caption.startswith("reference-a: 46.57 mm (I) felt, 232.8 mm (III) quiet")
    assert picture == "written: click.png"
    assert sound.startswith(
        "written: click.wav: 46.57 mm (I), 232.8 mm (III) (one after another): acceleration weighted"
    )
    with wave.open(str(click_table.parent / "click.wav"), "rb") as file:
        assert file.getframerate() == 48_000
    assert run(*WORDS["click"], "--sound", "click.wav", "--stereo", "--plain", "--json") == 0
    said = strict_json(capsys.readouterr().out)["sound"]
    assert (said["file"], said["channels"], said["is_weighted"]) == ("click.wav", 2, False)


def test_explain_tells_of_the_click(run: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("explain", "bar.nc", "--felt", "I", "--quiet", "III", "--click", "--level", "full", "--json") == 0
    values = strict_json(capsys.readouterr().out)
    assert values["table"]["places_m"] == pytest.approx([0.04657, 0.23283], abs=1e-5)
    assert len(values["alternatives"]) == 2
    assert run("explain", "bar.nc", "--felt", "I", "--quiet", "III", "--click", "--no-alternatives") == 0
    assert "a click of 20 ms, solved for these positions, 20 dB wanted" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (("click", "missing.nc", "--felt", "I"), ("missing.nc", "tactable build")),
        (("click", "bar.nc", "--felt", "VI"), ("'VI'", "I, II, III")),
        (("click", "bar.nc", "--felt", ","), ("--felt names no zone",)),
        (("click", "bar.nc", "--felt", "I", "--quiet", "I"), ("closer than 8 mm", "give one of them")),
        (("click", "bar.nc", "--felt", "I", "--level", "nan"), ("--level 'nan'",)),
        (("click", "bar.nc", "--felt", "I", "-o", "click.gif"), ("click.gif", ".png, .svg, .pdf")),
        (("click", "bar.nc", "--felt", "I", "--sound", "click.mp3"), ("click.mp3", ".wav")),
        (("click", "bar.nc", "--felt", "I", "--sound", "nowhere/click.wav"), ("nowhere", "no such folder")),
        (("click", "bar.nc", "--felt", "I", "--plain"), ("--plain", "--sound click.wav")),
        (("click", "bar.nc", "--felt", "I", "--sound", "a.wav", "--stereo"), ("--stereo", "one felt and one quiet")),
    ],
)
def test_a_refusal_is_one_line_naming_the_thing(
    run: Any, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], parts: tuple[str, ...]
) -> None:
    assert run("plot", *words) == 1
    said = capsys.readouterr().err
    assert said.startswith("tactable: ")
    assert said.count("\n") == 1
    for part in parts:
        assert part in said
