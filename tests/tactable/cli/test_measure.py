"""The command `measure`: on a simulated bench, and over a real terminal with a real pipe of samples."""

import json
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from engine.device import Device
from firmware_link.emulator.emulator_process import run_emulator
from precompute.measurements.measurement_file import read_measurements
from precompute.measurements.types import Kind
from tactable.measure.sensor import SensorForm, write_header
from tests.engine.loop.rig import DEVICE
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
