"""The commands around calibration: what they write, refuse and leave alone, and the exit status that they end with."""

import hashlib
import json
import re
import shlex
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from engine.device import Device
from tests.tactable.cli.in_process import run_here

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[3]
DRIVES = "150,130;150,200;140,-"
run = partial(run_here, Path())


def simulated(path: Path, *options: str) -> Path:
    assert run("simulate-measurements", "reference-a", "-o", str(path), "--drives", DRIVES, *options).returncode == 0
    return path


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    changes = ("--change", "actuator[1].stiffness=20.5 kN/m", "--change", "actuator.full_scale=0.48 µm")
    return simulated(tmp_path_factory.mktemp("measured") / "m.csv", *changes, "--noise", "2 %", "--wrong", "5 %")


@pytest.fixture(scope="module")
def calibrated(measured: Path) -> tuple[Path, dict[str, Any]]:
    folder = measured.parent / "new"
    done = run("calibrate", "reference-a", str(measured), "-o", str(folder), "--starts", "1", "--json")
    assert done.returncode == 0, done.stderr
    return folder, json.loads(done.stdout)


def test_a_new_folder_holds_the_measured_device_what_to_flash_data_report_and_picture(
    measured: Path, calibrated: tuple[Path, Any]
) -> None:
    folder, printed = calibrated
    names = ["fit.png", "measurements.csv", "reference-a.toml", "report.json", "report.md"]
    assert sorted(path.name for path in folder.iterdir()) == names
    assert (folder / "measurements.csv").read_bytes() == measured.read_bytes()
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    device = Device.read(Path(printed["device_file"]))
    assert report["fingerprint"] == device.fingerprint
    assert report["sha256"] == hashlib.sha256(measured.read_bytes()).hexdigest()
    assert (folder / "fit.png").read_bytes().startswith(b"\x89PNG")
    assert device.actuators[0].stiffness_n_per_m == pytest.approx(20.5e3, rel=5e-3)
    assert device.actuators[1].full_scale_m == pytest.approx(0.48e-6, rel=1e-2)
    assert device.uncertainty is not None
    assert printed["simulated"] and printed["doubts"] == []
    flashed = ", ".join(f"{1e12 * actuator.full_scale_m:.0f}" for actuator in device.actuators)
    assert printed["flash"] == f"full_scales_pm = {{{flashed}}}"
    assert f"Flash the board with `{printed['flash']}`" in (folder / "report.md").read_text(encoding="utf-8")


def test_simulated_measurements_are_marked_and_never_overwrite(tmp_path: Path) -> None:
    path = simulated(tmp_path / "m.csv", "--points", "3", "--seed", "4")
    text = path.read_text(encoding="utf-8")
    assert text.startswith("# SIMULATED by tactable simulate-measurements: reference-a; ")
    assert len(text.splitlines()) == 2 + 9
    again = run("simulate-measurements", "reference-a", "-o", str(path))
    assert again.returncode == 1 and "exists already" in again.stderr
    assert path.read_text(encoding="utf-8") == text


def test_the_shipped_measurements_are_made_by_the_command_in_their_first_line(tmp_path: Path) -> None:
    shipped = ROOT / "tables" / "measurements" / "reference-a-drifted.csv"
    text = shipped.read_text(encoding="utf-8")
    made = re.findall(r"^tactable (simulate-measurements .*)$", (ROOT / "tables" / "MEASUREMENTS.md").read_text(), re.M)
    words = shlex.split(made[0].replace(f"measurements/{shipped.name}", str(tmp_path / "m.csv")))
    assert run(*words).returncode == 0
    again = (tmp_path / "m.csv").read_text(encoding="utf-8")
    assert again.splitlines()[:2] == text.splitlines()[:2]
    for line, other in zip(again.splitlines()[2:], text.splitlines()[2:], strict=True):
        assert [float(cell or 0) for cell in line.split(",")] == pytest.approx(
            [float(cell or 0) for cell in other.split(",")], rel=1e-5
        )
