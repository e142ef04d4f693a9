"""The command `tactable study`: pictures, data and summaries, and how it refuses."""

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from engine.device import Device
from tactable.cli.main import main
from tactable.shipped import find_device

_CHANGES = {"count = 5": "count = 2", 'step = "1 Hz"': 'step = "4 Hz"'}


@pytest.fixture
def tactable_study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Run `tactable study` with these words beside bar.toml, of two zones; its exit status."""
    text = find_device("reference-a").text
    for old, new in _CHANGES.items():
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "bar.toml").write_text(text, encoding="utf-8")
    (tmp_path / "one.toml").write_text(text.replace("count = 2", "count = 1"), encoding="utf-8")

    def run(*words: str) -> int:
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", ["tactable", "study", *words])
        with pytest.raises(SystemExit) as end:
            main()
        return int(end.value.code or 0)

    return run


def strict_json(text: str) -> Any:
    """JSON without what only Python reads: NaN and Infinity."""
    return json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))


@pytest.mark.long
def test_a_placement_comes_with_its_data_and_a_summary(
    tmp_path: Path, tactable_study: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("placement", "bar.toml", "--actuators", "2", "--most", "6", "--workers", "1", "--json")
    assert tactable_study(*words, "-o", "p.svg", "-o", "p.csv") == 0
    summary = strict_json(capsys.readouterr().out)
    (search,) = summary["searches"]
    own = next(each for each in search["judged"] if each["placement"] == "as described")
    assert own["position_percent"] == pytest.approx([16.0, 97.7])
    assert own["worst_contrast_db"] == pytest.approx(min(own["contrast_db"][0][1], own["contrast_db"][1][0]))
    assert (tmp_path / "p.svg").stat().st_size > 10_000
    assert summary["written"] == ["reference-a-2-placed.toml"]
    written = Device.read(tmp_path / "reference-a-2-placed.toml")
    length_m = written.bar.length_m
    best_percent = search["judged"][0]["position_percent"]
    assert [100 * a.position_m / length_m for a in written.actuators] == pytest.approx(best_percent, abs=1e-3)
    assert len((tmp_path / "p.csv").read_text(encoding="utf-8").splitlines()) == 1 + 3 + search["screened"]


def test_it_says_how_much_was_looked_at_and_what_was_not(
    tactable_study: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    assert tactable_study("placement", "bar.toml", "--actuators", "1", "--most", "3", "--workers", "1") == 0
    said = capsys.readouterr()
    assert "written: placement.png" in said.out
    assert "looked at" in said.err and "not at states of more fingers, at clicks" in said.err


@pytest.mark.long
def test_a_resolution_comes_with_its_data_and_a_summary(
    tmp_path: Path, tactable_study: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("resolution", "bar.toml", "--zones", "2,3", "--at", "97.7,16;50", "--workers", "1", "--json")
    assert tactable_study(*words, "-o", "r.pdf", "-o", "r.csv") == 0
    summary = strict_json(capsys.readouterr().out)
    assert [each["position_percent"] for each in summary["placements"]] == [pytest.approx([16.0, 97.7]), [50.0]]
    assert [each["zones"] for each in summary["placements"]] == [[2, 3], [2, 3]]
    assert len((tmp_path / "r.csv").read_text(encoding="utf-8").splitlines()) == 5
    assert (tmp_path / "r.pdf").read_bytes().startswith(b"%PDF")
