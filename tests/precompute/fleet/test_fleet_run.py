"""Laws of a fleet: a unit is done or says why not, what is done is not done again, and no crash leaves half of it."""

import json
import multiprocessing
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from engine.device import Device
from engine.table import Table
from precompute.builder.code_fingerprint import code_fingerprint
from precompute.fleet.fleet_run import DEVICE, OUTCOME, TABLE, Pool, run_fleet, run_here, run_on_processes
from precompute.fleet.units import FleetOptions, Outcome, Unit, make_job, plan_fleet
from tests.precompute.fleet.small_fleet import small_text, write_measurements, write_unit

pytestmark = pytest.mark.long

OPTIONS = FleetOptions(clicks_up_to=0)
BROKEN = {"empty": "device.toml", "unitless": "'0.79'", "unmeasured": "measurements.csv", "zoneless": "count"}
"""Units that cannot be built, and a word of why."""


def run(bars: Path, out: Path, pool: Pool = run_here, options: FleetOptions = OPTIONS) -> dict[str, Outcome]:
    outcomes = run_fleet(plan_fleet(bars), options, out, pool, created="2024-01-01")
    return {outcome.name: outcome for outcome in outcomes}


def write_broken(bars: Path) -> None:
    (bars / "empty").mkdir()
    write_unit(bars / "unitless", small_text().replace('"0.79 mm"', '"0.79"'))
    (write_unit(bars / "unmeasured", small_text()) / "measurements.csv").write_text(
        "position (mm)\n1\n", encoding="utf-8"
    )
    write_unit(bars / "zoneless", small_text().replace("count = 2", "count = 0"))


def write_good(bars: Path, stiffnesses: Sequence[float]) -> None:
    for i, stiffness in enumerate(stiffnesses):
        write_unit(bars / f"good-{i}", small_text(f"{stiffness} kN/m"))


def assert_complete(folder: Path) -> None:
    with Table.open(folder / TABLE, device=Device.read(folder / DEVICE), code_fingerprint=code_fingerprint()) as table:
        assert len(table.best_rows) == 3
    assert json.loads((folder / OUTCOME).read_text(encoding="utf-8"))["fingerprint"] == table.fingerprint
    assert not list(folder.glob(".*"))


@pytest.fixture(scope="module")
def bars(tmp_path_factory: pytest.TempPathFactory) -> Path:
    bars = tmp_path_factory.mktemp("bars")
    write_good(bars, (18.0, 18.9, 19.2))
    write_broken(bars)
    write_measurements(write_unit(bars / "measured", small_text()), true=small_text("19.3 kN/m"))
    return bars


@pytest.fixture(scope="module")
def done(bars: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Outcome]]:
    out = tmp_path_factory.mktemp("out")
    return out, run(bars, out)


def test_a_bad_unit_is_named_and_stops_no_other(done: tuple[Path, dict[str, Outcome]]) -> None:
    out, outcomes = done
    for name, word in BROKEN.items():
        error = outcomes[name].error
        assert error is not None
        assert word in error
        assert "\n" not in error
        assert not (out / name / OUTCOME).exists()
    for name in set(outcomes) - set(BROKEN):
        assert outcomes[name].error is None
        assert_complete(out / name)
        assert outcomes[name].figures["worst_expected_contrast_db"] is not None


def test_a_measured_unit_is_calibrated_with_data_and_report_beside_it(done: tuple[Path, dict[str, Outcome]]) -> None:
    out, outcomes = done
    values = outcomes["measured"].values
    assert values["actuator[1].stiffness_n_per_m"] == pytest.approx(19300.0, rel=1e-5)
    assert "uncertainty.actuator[1].stiffness" in values
    (folder,) = (out / "measured").glob("calibration-*")
    assert {path.name for path in folder.iterdir()} >= {
        "measurements.csv",
        "report.json",
        "report.md",
        "reference-a.toml",
    }


def test_what_is_done_is_kept_and_what_failed_is_tried_again(bars: Path, done: tuple[Path, dict[str, Outcome]]) -> None:
    out, outcomes = done
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*")}
    again = run(bars, out)
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*") if "good" in str(path)} == {
        path: time for path, time in before.items() if "good" in str(path)
    }
    for name, outcome in again.items():
        assert outcome.is_kept == (name not in BROKEN)
        assert (outcome.figures, outcome.error) == (outcomes[name].figures, outcomes[name].error)


def test_other_inputs_or_damaged_results_are_built_again(
    bars: Path, done: tuple[Path, dict[str, Outcome]], tmp_path: Path
) -> None:
    (made, first), units, out = done, tmp_path / "bars", tmp_path / "out"
    for name in ("good-0", "good-1", "good-2"):
        shutil.copytree(bars / name, units / name)
        shutil.copytree(made / name, out / name)
    (units / "good-0" / "device.toml").write_text(small_text("17 kN/m"), encoding="utf-8")
    table = out / "good-1" / TABLE
    content = bytearray(table.read_bytes())
    content[len(content) // 2] ^= 1
    table.write_bytes(content)
    (out / "good-2" / OUTCOME).write_text("{", encoding="utf-8")
    again = run(units, out)
    assert not any(outcome.is_kept for outcome in again.values())
    assert again["good-0"].fingerprint != first["good-0"].fingerprint
    assert again["good-1"].figures == first["good-1"].figures
    for name in again:
        assert_complete(out / name)


def test_whatever_decides_a_table_decides_whether_it_is_kept(tmp_path: Path) -> None:
    folder = write_unit(tmp_path / "bar", small_text())
    write_measurements(folder, small_text())
    unit = Unit("bar", folder / "device.toml")
    variants = (
        OPTIONS,
        FleetOptions(),
        FleetOptions(clicks_up_to=0, pitch_m=5e-3),
        FleetOptions(clicks_up_to=0, also=("bar.density",)),
    )
    units = (
        unit,
        replace(unit, values={"bar.width": "13 mm"}),
        replace(unit, measurements=folder / "measurements.csv"),
    )
    keys = {make_job(unit, options, tmp_path, "").key for unit in units for options in variants}
    assert len(keys) == len(units) * len(variants)
    assert make_job(unit, OPTIONS, tmp_path / "elsewhere", "later").key == make_job(unit, OPTIONS, tmp_path, "").key


@pytest.mark.machine(stall_s=None)
def test_a_killed_worker_costs_nothing_but_time(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    bars, out = tmp_path / "bars", tmp_path / "out"
    write_good(bars, (18.0, 18.2))
    write_broken(bars)
    killed = list[str]()

    def kill_one(_step: str, _fraction: float) -> None:
        if killed:
            return
        worker = multiprocessing.active_children()[0]
        worker.kill()
        killed.append(worker.name)

    outcomes = run_fleet(plan_fleet(bars), OPTIONS, out, run_on_processes(2), created="", progress=kill_one)
    assert killed
    assert {outcome.name for outcome in outcomes if outcome.error is not None} == set(BROKEN)
    for i in range(2):
        assert_complete(out / f"good-{i}")
