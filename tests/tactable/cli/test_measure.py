"""The commands `measure` and `verify`: on a simulated bench, and over a real terminal with a real pipe of samples."""

import json
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.device import Device
from engine.table import Table
from engine.table.best_rows import write_best_rows
from engine.table.netcdf_file import TableWriter
from firmware_link.emulator.emulator_process import run_emulator
from precompute.measurements.measurement_file import read_measurements
from precompute.measurements.types import Kind
from tactable.measure import verification
from tactable.measure.sensor import SensorForm, write_header
from tests.engine.loop.rig import DEVICE
from tests.engine.made_table import rows_of
from tests.tactable.cli.in_process import run_here

SIMULATED = ("--port", "simulated", "--sensor", "simulated")
ROOT = Path(__file__).parents[3]
RATE_HZ = 8_000.0
HZ = 165.0
RESPONSE = 3.0 - 4.0j
LEAST = 0.05


def test_a_simulated_bar_is_measured_into_every_form(tmp_path: Path) -> None:
    words = ("--places", "1", "--frequencies", "170,209", "--peaks", "peaks.csv", "--gravity", "--json")
    outputs = ("-o", "bar.csv", "-o", "bar.uff")
    done = run_here(tmp_path, "measure", "reference-a", *outputs, *SIMULATED, *words, "--flaws", "gain=2%,drift=60")
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert (summary["readings"], summary["spoiled"], summary["faults"]) == (4, 0, {"CLOCK_DRIFT": 4})
    assert summary["drift_ppm"] == pytest.approx(60, abs=1)
    assert summary["gravity"]["gain"] == pytest.approx(0.02, abs=1e-3)
    assert "gravity does not read as 9.81" in done.stderr
    found = [read_measurements(tmp_path / f"bar.{ending}", DEVICE, 2e-3) for ending in ("csv", "uff")]
    assert all(each.is_simulated and each.kind is Kind.RESPONSE and len(each) == 4 for each in found)
    peaks = read_measurements(tmp_path / "peaks.csv", DEVICE)
    np.testing.assert_allclose(peaks.acceleration, abs(found[0].acceleration), rtol=1e-5)


def test_a_spoiled_reading_is_named_left_out_and_the_exit_status(tmp_path: Path) -> None:
    words = ("--places", "1", "--frequencies", "150,209", "--flaws", "hum=1m/s^2")
    done = run_here(tmp_path, "measure", "reference-a", "-o", "bar.csv", *SIMULATED, *words)
    assert done.returncode == 3, done.stderr
    assert "2 readings: mains hum" in done.stdout
    assert "150 Hz at 100 %" in done.stdout
    assert len(read_measurements(tmp_path / "bar.csv", DEVICE)) == 2


@contextmanager
def converter(pipe: Path) -> Iterator[None]:
    """A program that writes a tone and its loopback into a pipe at the pace of the clock."""
    form = SensorForm(RATE_HZ, ("acceleration", "loopback left", "loopback right"), (np.inf,) * 3)
    is_over = threading.Event()

    def write() -> None:
        sent, start_s = 0, time.monotonic()
        with pipe.open("wb", buffering=0) as file:
            file.write(write_header(form))
            while not is_over.wait(0.01):
                count = int((time.monotonic() - start_s) * RATE_HZ) - sent
                tone = LEAST * np.exp(2j * np.pi * HZ * (sent + np.arange(count)) / RATE_HZ)
                values = np.column_stack([(RESPONSE * tone).real, tone.real, tone.real])
                try:
                    file.write(values.astype("<f4").tobytes())
                except BrokenPipeError:
                    return
                sent += count

    writer = threading.Thread(target=write)
    writer.start()
    try:
        yield
    finally:
        is_over.set()
        writer.join()


@pytest.mark.machine
def test_a_board_on_a_terminal_and_samples_in_a_pipe_are_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pipe = tmp_path / "samples"
    os.mkfifo(pipe)
    monkeypatch.setattr("builtins.input", lambda: "")
    words = ("--places", "1", "--frequencies", str(HZ), "--least", "5 %")
    with run_emulator() as emulator, converter(pipe):
        where = ("--port", emulator.port, "--sensor", str(pipe))
        done = run_here(tmp_path, "measure", "reference-a", "-o", "bar.csv", *where, *words)
        events = emulator.stop().events
    assert done.returncode == 0, done.stderr + done.stdout
    assert "sensor to 5.6 mm, then Enter" in done.stderr
    found = read_measurements(tmp_path / "bar.csv", DEVICE)
    np.testing.assert_allclose(found.acceleration, LEAST * RESPONSE, rtol=1e-3)
    assert not found.is_simulated
    assert max(channel.amplitude for event in events for channel in event.channels) == pytest.approx(LEAST, abs=1e-4)
    assert not any(channel.amplitude for channel in events[-1].channels)


def test_transfer_functions_are_found_and_written_into_a_new_device_file(tmp_path: Path) -> None:
    bare = (ROOT / "tables" / "devices" / "reference-a.toml").read_text(encoding="utf-8")
    exact = bare.replace('stiffness = "1 %" #', 'stiffness = "0.02 %" #').replace('mass = "1 %"\n', 'mass = "0.02 %"\n')
    points = '[["60 Hz", "95 %", "-6 deg"], ["180 Hz", "89 %", "-17 deg"], ["300 Hz", "80 %", "-27 deg"]]'
    (tmp_path / "true.toml").write_text(exact.replace('name = "left"\n', f'name = "left"\ntransfer = {points}\n'))
    words = ("--places", "3", "--frequencies", "66,140,284", "--transfer", "found.toml")
    done = run_here(tmp_path, "measure", "true.toml", "-o", "bar.csv", *SIMULATED, *words)
    assert done.returncode == 0, done.stderr
    assert "transfer function of left: 3 points" in done.stdout
    text = (tmp_path / "found.toml").read_text(encoding="utf-8")
    assert text.startswith("# SIMULATED")
    true, found = (Device.read(tmp_path / f"{name}.toml").actuators for name in ("true", "found"))
    assert true[0].transfer is not None
    assert found[0].transfer is not None
    assert found[1].transfer is not None
    hz = np.array(found[0].transfer.frequency_hz)
    assert found[0].transfer.value == pytest.approx(true[0].transfer.at(hz), rel=0.01)
    assert found[1].transfer.value == pytest.approx(np.ones(3), rel=0.01)
    again = run_here(tmp_path, "measure", "true.toml", "-o", "bar.csv", *SIMULATED, *words)
    assert again.returncode == 1
    assert "found.toml: exists already" in again.stderr


VERIFIED = (*SIMULATED, "--places", "1", "--placements", "2")


@pytest.fixture(autouse=True, scope="module")
def bars_once() -> Iterator[None]:
    """The bars that a table holds for possible are the same each time that it is verified."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(verification, "PossibleSurfaces", cache(verification.PossibleSurfaces))
        yield


def verified(folder: Path, table: Path, *words: str, exit_status: int) -> dict[str, Any]:
    done = run_here(folder, "verify", str(table), *VERIFIED, *words, "--json")
    assert done.returncode == exit_status, done.stderr
    summary = json.loads(done.stdout)
    assert isinstance(summary, dict) and summary["simulated"]
    return summary


def test_the_bar_of_a_table_keeps_its_promise_in_drives_and_clicks_whatever_offset_and_sign_of_the_sensor_are(
    tmp_path: Path, click_table: Path
) -> None:
    flaws = "drift=40,offset=50m/s^2,gain=-200%"
    summary = verified(tmp_path, click_table, "-o", "seen.png", "-o", "seen.csv", "--flaws", flaws, exit_status=0)
    assert (summary["verdict"], summary["kept"]) == ("kept", 4)
    assert summary["faults"] == {"CLOCK_DRIFT": 2, "OFFSET": 4}
    assert sorted(point["kind"] for point in summary["points"]) == ["click", "click", "drive", "drive"]
    for point in summary["points"]:
        assert point["low_m_per_s2"] < point["promised_m_per_s2"] < point["high_m_per_s2"]
        assert abs(point["difference_db"]) < (0.1 if point["kind"] == "drive" else 0.5)
    assert (tmp_path / "seen.png").stat().st_size > 10_000
    assert len((tmp_path / "seen.csv").read_text(encoding="utf-8").splitlines()) == 5


def with_rows(click_table: Path, path: Path) -> Path:
    with Table.open(click_table) as table, TableWriter(path) as writer:
        kept = {key: value for key, value in table.attributes.items() if not key.startswith(("_", "format"))}
        writer.describe({key: value.item() if hasattr(value, "item") else value for key, value in kept.items()})
        table.copy_groups(writer, ["responses", "modes", "entries", "clicks"])
        write_best_rows(writer, rows_of(table.device), table.device)
    return path


@pytest.mark.parametrize("tones", [1, 2])
def test_the_bar_of_a_table_keeps_what_rows_of_the_sweep_promise(tmp_path: Path, click_table: Path, tones: int) -> None:
    path = click_table if tones == 1 else with_rows(click_table, tmp_path / "two.nc")
    summary = verified(tmp_path, path, "--drives", "zones", exit_status=0)
    assert (summary["verdict"], summary["kept"]) == ("kept", 2)
    assert all(point["kind"] == "drive" and abs(point["difference_db"]) < 0.1 for point in summary["points"])


def test_another_bar_is_beyond_the_promise_and_the_exit_status(tmp_path: Path, click_table: Path) -> None:
    done = run_here(tmp_path, "verify", str(click_table), *VERIFIED, "--change", "actuator.full_scale=0.8 µm")
    assert done.returncode == 3, done.stderr
    assert "4 break it" in done.stdout and "the bar does not keep the promise" in done.stdout
    assert "measure the bar and calibrate" in done.stderr
