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
    assert summary["best_rows"] == 7
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


def test_a_zone_means_its_middle(built: Path) -> None:
    of_zones = explained(built, "--felt", "I", "--quiet", "III")
    middles = explained(built, "--felt", "46.567 mm", "--quiet", "232.833 mm")
    assert of_zones["drive"]["frequencies_hz"] == pytest.approx(middles["drive"]["frequencies_hz"], abs=0.05)
    assert of_zones["contrast_db"] == pytest.approx(middles["contrast_db"], abs=0.05)
    assert {key: len(values) for key, values in of_zones["drive"].items()} == {
        "frequencies_hz": 2,
        "amplitudes": 2,
        "phases_rad": 2,
    }
    assert {"device", "fingerprint", "achieved", "contrast_db", "t90_s", "threshold"} <= set(of_zones)


def test_frames_are_one_object_a_line(tmp_path: Path) -> None:
    done = run_here(tmp_path, "replay", str(DEMO_RECORDING), "--frames", "--json")
    frames = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(frames) == 692
    assert frames[0] == {"report": 0, "t_s": 0.0, "contacts": [{"id": 0, "x": 1638, "y": 511, "tip": True}]}
    assert frames[-1]["contacts"] == []
