"""The command: what it prints for machines, and how it refuses."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tactable.shipped import DEMO_RECORDING, device_folder, find_device, shipped_names

TACTABLE = str(Path(sys.executable).parent / "tactable")


def tactable(*words: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([TACTABLE, *words], cwd=folder, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the table of a coarse reference-a."""
    folder = tmp_path_factory.mktemp("built")
    text = (device_folder() / "reference-a.toml").read_text(encoding="utf-8")
    (folder / "bar.toml").write_text(text.replace('step = "1 Hz"', 'step = "8 Hz"'), encoding="utf-8")
    done = tactable("build", "bar.toml", "-o", "bar.nc", "--json", folder=folder)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["entries"] == 31
    return folder


def test_the_shipped_devices_are_found_by_name() -> None:
    assert shipped_names() == ["reference-a", "reference-d"]
    assert [find_device(name).name for name in shipped_names()] == shipped_names()


def test_explain_gives_the_agreed_fields(built: Path) -> None:
    done = tactable("explain", "bar.nc", "--felt", "I,III,V", "--json", folder=built)
    entry = json.loads(done.stdout)
    fields = {
        "device",
        "fingerprint",
        "state",
        "drive",
        "localized_factor",
        "contrast_db",
        "t90_s",
        "limited_by",
        "zones",
    }
    assert fields <= set(entry)
    assert {key: len(values) for key, values in entry["drive"].items()} == {
        "frequencies_hz": 2,
        "amplitudes": 2,
        "phases_rad": 2,
    }
    assert [zone["name"] for zone in entry["zones"]] == ["I", "II", "III", "IV", "V"]
    assert [zone["state"] for zone in entry["zones"]] == ["felt", "free", "felt", "free", "felt"]
    assert {"share", "peak_acceleration_m_per_s2", "peak_position_m"} <= set(entry["zones"][0])
    felt = sum(zone["share"] for zone in entry["zones"] if zone["state"] == "felt")
    assert abs(felt - entry["localized_factor"]) < 1e-9


def test_explain_says_it_in_words(built: Path) -> None:
    done = tactable("explain", "bar.nc", "--felt", "II", folder=built)
    assert done.returncode == 0
    assert "localized factor" in done.stdout
    assert "limited by" in done.stdout
    assert "ESTIMATES" in done.stdout


def test_frames_are_one_object_a_line(tmp_path: Path) -> None:
    done = tactable("replay", str(DEMO_RECORDING), "--frames", "--json", folder=tmp_path)
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
        (("explain", "bar.nc", "--felt", "VI"), ("'VI'", "I, II, III, IV, V")),
        (("explain", "bar.nc", "--felt", ","), ("--felt",)),
        (("replay", "bar.toml"), ("bar.toml",)),
        (("demo", "--recording", "missing.hid"), ("missing.hid",)),
    ],
)
def test_a_refusal_is_one_line_naming_the_thing(built: Path, words: tuple[str, ...], parts: tuple[str, ...]) -> None:
    done = tactable(*words, folder=built)
    assert done.returncode == 1
    assert done.stderr.startswith("tactable: ")
    assert done.stderr.count("\n") == 1
    for part in parts:
        assert part in done.stderr
