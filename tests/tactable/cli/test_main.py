"""The command: what it prints for machines, and how it refuses."""

import json
from pathlib import Path
from typing import Any

import pytest

from engine.device import Device
from tactable.shipped import DEMO_RECORDING, device_folder, find_device, shipped_names
from tests.tactable.cli.in_process import run_here


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the table of a coarse reference-a with three zones and two levels."""
    folder = tmp_path_factory.mktemp("built")
    text = (device_folder() / "reference-a.toml").read_text(encoding="utf-8")
    for old, new in (('step = "1 Hz"', 'step = "20 Hz"'), ("count = 5", "count = 3"), (', "30 dB"', "")):
        assert old in text
        text = text.replace(old, new)
    (folder / "bar.toml").write_text(text, encoding="utf-8")
    few = ("--clicks-up-to", "1", "--pitch", "140 mm", "--workers", "1")
    done = run_here(folder, "build", "bar.toml", "-o", "bar.nc", *few, "--json")
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert summary["entries"] == 19 * 3
    assert summary["estimates"] == len(Device.parse(text, "bar.toml").estimated_values)
    return folder


def test_the_shipped_devices_are_found_by_name() -> None:
    assert shipped_names() == ["reference-a", "reference-d", "reference-t"]
    assert [find_device(name).name for name in shipped_names()] == shipped_names()


def explained(folder: Path, *words: str) -> dict[str, Any]:
    done = run_here(folder, "explain", "bar.nc", *words, "--json")
    assert done.returncode == 0, done.stderr
    entry: dict[str, Any] = json.loads(done.stdout)
    return entry


def test_explain_gives_the_agreed_fields(built: Path) -> None:
    entry = explained(built, "--felt", "I", "--quiet", "III", "--no-alternatives")
    fields = {
        "device",
        "fingerprint",
        "state",
        "drive",
        "level_db",
        "achieved",
        "localized_factor",
        "contrast_db",
        "optimality_gap_db",
        "t90_s",
        "limited_by",
        "worst_case",
        "zones",
    }
    assert fields <= set(entry)
    assert {key: len(values) for key, values in entry["drive"].items()} == {
        "frequencies_hz": 2,
        "amplitudes": 2,
        "phases_rad": 2,
    }
    assert [zone["name"] for zone in entry["zones"]] == ["I", "II", "III"]
    assert [zone["state"] for zone in entry["zones"]] == ["felt", "free", "quiet"]
    per_zone = {"share", "peak_acceleration_m_per_s2", "peak_position_m", "sensation_level_db"}
    assert per_zone | {"acceleration_at_finger_m_per_s2"} <= set(entry["zones"][0])
    assert entry["zones"][1]["sensation_level_db"] is None
    felt = sum(zone["share"] for zone in entry["zones"] if zone["state"] == "felt")
    assert abs(felt - entry["localized_factor"]) < 1e-9


def test_contrast_is_the_difference_of_the_weakest_felt_and_the_strongest_quiet_level(built: Path) -> None:
    entry = explained(built, "--felt", "I,III", "--quiet", "II", "--no-alternatives")
    levels = {
        state: [z["sensation_level_db"] for z in entry["zones"] if z["state"] == state] for state in ("felt", "quiet")
    }
    assert entry["contrast_db"] == pytest.approx(min(levels["felt"]) - max(levels["quiet"]))
    assert entry["level_db"] == pytest.approx(min(levels["felt"]))


def test_between_levels_a_tabulated_drive_is_played_louder_or_softer(built: Path) -> None:
    entry, *tabulated = (
        explained(built, "--felt", "I", "--level", level, "--no-alternatives") for level in ("17", "10", "20")
    )
    assert entry["level_db"] == pytest.approx(17.0, abs=1e-3)
    near = next(each for each in tabulated if each["drive"]["frequencies_hz"] == entry["drive"]["frequencies_hz"])
    scale = 10 ** ((17.0 - near["level_db"]) / 20)
    assert entry["drive"]["amplitudes"] == pytest.approx([a * scale for a in near["drive"]["amplitudes"]], rel=1e-3)


def test_an_alternative_never_beats_the_entry(built: Path) -> None:
    entry = explained(built, "--felt", "I", "--quiet", "III")
    names = [rival["name"] for rival in entry["alternatives"]]
    assert {"left alone", "right alone", "localized factor", "paper"} <= set(names)
    for rival in entry["alternatives"]:
        reaches = rival["level_db"] >= entry["wanted_level_db"] - 1e-3
        assert not reaches or rival["expected_contrast_db"] <= entry["expected_contrast_db"] + 0.05, rival["name"]
        assert rival["lost_by"]


def test_explain_says_it_in_words(built: Path) -> None:
    done = run_here(built, "explain", "bar.nc", "--felt", "II", "--quiet", "III")
    assert done.returncode == 0
    for part in ("localized factor", "limited by", "worst over", "lost", "ESTIMATES"):
        assert part in done.stdout
    assert "model: 50 elements of up to 5.8 mm, 20 modes, 16 for clicks" in done.stdout


def test_frames_are_one_object_a_line(tmp_path: Path) -> None:
    done = run_here(tmp_path, "replay", str(DEMO_RECORDING), "--frames", "--json")
    frames = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(frames) == 692
    assert frames[0] == {"report": 0, "t_s": 0.0, "contacts": [{"id": 0, "x": 1638, "y": 511, "tip": True}]}
    assert frames[-1]["contacts"] == []


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (("build", "no-such-bar"), ("no-such-bar", "reference-a")),
        (("build", "bar.toml", "-o", "nowhere/bar.nc"), ("nowhere", "no such folder")),
        (("explain", "bar.toml", "--felt", "I"), ("not a table",)),
        (("explain", "missing.nc", "--felt", "I"), ("missing.nc", "tactable build")),
        (("explain", "bar.nc", "--felt", "V"), ("'V'", "I, II, III")),
        (("explain", "bar.nc", "--felt", ","), ("--felt",)),
        (("explain", "bar.nc", "--felt", "I", "--quiet", "I"), ("zone I", "once")),
        (("explain", "bar.nc", "--felt", "I", "--level", "loud"), ("--level", "full")),
        (("explain", "bar.nc", "--felt", "I", "--level", "nan"), ("--level", "0 or more")),
        (("build", "bar.toml", "--objective", "contrst"), ("'contrst'", "standard contrast")),
        (("replay", "bar.toml"), ("bar.toml",)),
        (("demo", "--recording", "missing.hid"), ("missing.hid",)),
    ],
)
def test_a_refusal_is_one_line_naming_the_thing(built: Path, words: tuple[str, ...], parts: tuple[str, ...]) -> None:
    done = run_here(built, *words)
    assert done.returncode == 1
    assert done.stderr.startswith("tactable: ")
    assert done.stderr.count("\n") == 1
    for part in parts:
        assert part in done.stderr
