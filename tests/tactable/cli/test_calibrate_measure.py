"""`calibrate --measure --apply`: from a bar that changed to a table that the bar was seen to keep, in one command."""

import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from engine.device import Device
from engine.table import Table
from engine.table.history import previous_of
from precompute.builder.build import build_table
from precompute.measurements.netcdf_content import load_content
from tactable.cli.console import EXIT_DOUBTFUL
from tests.precompute.builder.test_build import ONE_LEVEL
from tests.tactable.cli.in_process import run_here, summary_of

WORDS = ("calibrate", "bar.toml", "bar-measured.nc", "-o", "new", "--starts", "1", "--measure", "--apply", "bar.nc")
BENCH = ("--port", "simulated", "--sensor", "simulated", "--method", "sweep", "--places", "2", "--json")
CHANGED = ("--change", "actuator[1].stiffness=20.5 kN/m")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    (folder / "bar.toml").write_text(ONE_LEVEL, encoding="utf-8")
    build_table(Device.parse(ONE_LEVEL, "bar.toml"), folder / "bar.nc", created="at first", clicks_up_to=0)
    return folder


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """What was measured is read here, and no other process builds, as on a machine of one core."""
    monkeypatch.setattr("precompute.measurements.netcdf.read_content", load_content)
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    yield
    os.sched_setaffinity(0, cores)


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    for path in made.iterdir():
        shutil.copy(path, tmp_path)
    return tmp_path


@pytest.mark.long
@pytest.mark.usefixtures("in_this_process")
def test_a_bar_that_changed_is_measured_fitted_built_for_verified_and_the_table_put_in_place(folder: Path) -> None:
    before = (folder / "bar.nc").read_bytes()
    words = (*WORDS, *BENCH, *CHANGED, "--flaws", "noise=0.01m/s^2,drift=30")
    said = summary_of(folder, *words)
    assert {"fit", "verify on the bar", "put in place"} <= said["applied"]["seconds"].keys()
    with Table.open(folder / "bar.nc") as table:
        assert table.device.actuators[0].stiffness_n_per_m == pytest.approx(20.5e3, rel=5e-3)
    assert previous_of(folder / "bar.nc").read_bytes() == before
    measured, placed = (folder / "bar-measured.nc").read_bytes(), (folder / "bar.nc").read_bytes()
    summary_of(folder, *words)
    assert (folder / "bar-measured.nc").read_bytes() == measured and (folder / "bar.nc").read_bytes() == placed


@pytest.mark.long
@pytest.mark.usefixtures("in_this_process")
def test_a_bar_that_no_parameter_describes_leaves_the_table(folder: Path) -> None:
    before = (folder / "bar.nc").read_bytes()
    done = run_here(folder, *WORDS, *BENCH, "--change", "actuator[1].mass=14 g", "--fit", "actuator.full_scale")
    assert done.returncode == EXIT_DOUBTFUL, done.stderr
    assert json.loads(done.stdout)["doubts"]
    assert (folder / "bar.nc").read_bytes() == before
