"""From measurements to the table that is played: built as the one before was, or left; never lost, never done twice."""

import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from engine.device import Device
from engine.table import Table
from engine.table.history import previous_of
from precompute.builder.table_build import build_table
from precompute.clicks.click_options import ClickOptions
from precompute.measurements.parameters import paper_names
from tactable.calibration.apply import apply_fit
from tactable.calibration.job import CalibrationJob
from tactable.cli.console import EXIT_DOUBTFUL
from tactable.cli.main import app
from tests.precompute.builder.test_table_build import ONE_LEVEL

pytestmark = pytest.mark.long

CHEAP = ClickOptions(pitch_m=280e-3, pool=90, judged=10)
WISHES: dict[str, Any] = {"clicks_up_to": 2, "click_options": CHEAP}
TWO_ZONES = ONE_LEVEL.replace("count = 3", "count = 2")
DEVICE = Device.parse(TWO_ZONES, "bar.toml")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    (folder / "bar.toml").write_text(TWO_ZONES, encoding="utf-8")
    build_table(DEVICE, folder / "bar.nc", created="at first", **WISHES)
    words = ["simulate-measurements", str(folder / "bar.toml"), "-o", str(folder / "measured.csv"), "--points", "12"]
    done = CliRunner().invoke(app, [*words, "--change", "actuator[1].stiffness=20.5 kN/m"])
    assert done.exit_code == 0, done.output
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for path in made.iterdir():
        shutil.copy(path, tmp_path)
    return tmp_path


@pytest.fixture(autouse=True)
def one_core() -> Iterator[None]:
    """As on a machine of one core: no other process builds, whose start would take as long as the work."""
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {sorted(cores)[os.getpid() % len(cores)]})
    yield
    os.sched_setaffinity(0, cores)


def apply(*options: str, measurements: str = "measured.csv") -> Result:
    words = ["calibrate", "bar.toml", measurements, "-o", "new", "--starts", "1", "--apply", "bar.nc"]
    return CliRunner().invoke(app, [*words, *options])


def applied(*options: str, measurements: str = "measured.csv") -> dict[str, Any]:
    """What it says of the table."""
    done = apply("--json", *options, measurements=measurements)
    assert done.exit_code == 0, done.output
    said: dict[str, Any] = json.loads(done.stdout)["applied"]
    return said


def most_fingers(path: Path) -> int:
    with Table.open(path) as table:
        return max(len(click.placement.position_m) for click in table.clicks)


def test_the_table_is_built_for_the_new_bar_as_it_was_built_before(folder: Path) -> None:
    said = applied()
    new = Device.parse((folder / "new" / "reference-a.toml").read_text(encoding="utf-8"), "new")
    assert new.actuators[0].stiffness_n_per_m == pytest.approx(20.5e3, rel=1e-2)
    build_table(new, folder / "scratch.nc", created="by hand", **WISHES)
    with Table.open(folder / "bar.nc", device=new) as table, Table.open(folder / "scratch.nc") as scratch:
        assert table.best_rows == scratch.best_rows
        assert table.checksums() == scratch.checksums()
    with Table.open(previous_of(folder / "bar.nc"), device=DEVICE) as before:
        assert before.attributes["created"] == "at first"
    assert {"start", "fit", "sweep", "verify", "put in place"} <= said["seconds"].keys()
    assert sum(said["seconds"].values()) == pytest.approx(said["in_place_after_s"], rel=1e-2)
    assert said["has_all_clicks"] and said["clicks_s"] > 0
    assert said["diff"]["best_rows"]["changed"] > 0
    assert "actuator[1].stiffness_n_per_m" in {change["key"] for change in said["diff"]["device"]}


def test_a_bar_that_changed_is_measured_fitted_built_for_verified_and_the_table_put_in_place(folder: Path) -> None:
    table, measured = folder / "bar.nc", folder / "bar-measured.csv"
    before = table.read_bytes()
    bench = ("--measure", "--port", "simulated", "--sensor", "simulated", "--method", "sweep", "--places", "2")
    changed = ("--change", "actuator[1].stiffness=20.5 kN/m", "--flaws", "drift=30", "--no-clicks")
    said = applied(*bench, *changed, measurements=measured.name)
    assert {"fit", "verify on the bar", "put in place"} <= said["seconds"].keys()
    with Table.open(table) as found:
        assert found.device.actuators[0].stiffness_n_per_m == pytest.approx(20.5e3, rel=5e-3)
    assert previous_of(table).read_bytes() == before
    contents = [path.read_bytes() for path in (measured, table)]
    applied(*bench, *changed, measurements=measured.name)
    assert [path.read_bytes() for path in (measured, table)] == contents


def test_asked_again_it_goes_on_where_it_was_and_for_the_same_does_nothing(folder: Path) -> None:
    files = (folder / "bar.nc", folder / "new" / "report.json")
    for wish, fingers in ((("--no-clicks",), 1), ((), 2)):
        said = applied(*wish)
        assert (said["has_all_clicks"], said["in_place_after_s"] is None) == (fingers == 2,) * 2
        assert most_fingers(folder / "bar.nc") == fingers
        with Table.open(previous_of(folder / "bar.nc"), device=DEVICE):
            pass  # not the table that was only completed
        whole = [path.read_bytes() for path in files]
        assert apply(*wish).exit_code == 0
        assert [path.read_bytes() for path in files] == whole


def test_a_doubtful_fit_leaves_the_table_unless_it_is_wanted_all_the_same(folder: Path) -> None:
    before = (folder / "bar.nc").read_bytes()
    strict = ("--accept", "0.001 %", "--no-clicks")
    done = apply(*strict)
    assert done.exit_code == EXIT_DOUBTFUL
    assert "left as it was, because the fit is doubtful" in done.stdout
    assert (folder / "bar.nc").read_bytes() == before and not previous_of(folder / "bar.nc").exists()
    assert (folder / "new" / "report.md").is_file()
    assert apply(*strict, "--despite-doubts").exit_code == 0
    assert previous_of(folder / "bar.nc").read_bytes() == before


def test_a_table_that_the_bar_does_not_keep_or_whose_test_was_interrupted_is_not_put_in_place(folder: Path) -> None:
    job = CalibrationJob(
        device=Device.read(folder / "bar.toml"),
        measurements=folder / "measured.csv",
        folder=folder / "new",
        names=paper_names(DEVICE),
        bounds={},
        sensor_mass_kg=0.0,
        starts=1,
        seed=0,
        accepted_misfit=0.2,
        is_strict=False,
    )
    before, played = (folder / "bar.nc").read_bytes(), list[str]()

    def interrupted(written: Path) -> str:
        with Table.open(written) as table:
            played.append(table.device.name)
        raise KeyboardInterrupt

    def is_unchanged() -> bool:
        others = [path.name for path in folder.iterdir() if "bar.nc" in path.name]
        return (folder / "bar.nc").read_bytes() == before and others == ["bar.nc"]

    with pytest.raises(KeyboardInterrupt):
        apply_fit(job, folder / "bar.nc", False, lambda *_: None, interrupted)
    assert played == [DEVICE.name] and is_unchanged() and not (folder / "new").exists()
    applied = apply_fit(job, folder / "bar.nc", False, lambda *_: None, lambda _: "3 of 4 points are beyond")
    assert applied.is_refused and applied.doubts == ["3 of 4 points are beyond"] and is_unchanged()
    assert (folder / "new" / "report.json").is_file()
    kept = apply_fit(job, folder / "bar.nc", False, lambda *_: None, lambda _: "")
    assert not kept.is_refused and previous_of(folder / "bar.nc").read_bytes() == before
