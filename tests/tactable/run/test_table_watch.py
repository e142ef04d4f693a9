"""A run that plays on while its table is replaced, damaged, rolled back; in processes of their own."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from engine.device import Device
from engine.table.columns import write_entries
from engine.table.file import TableWriter
from engine.table.history import roll_back
from engine.touch.sources.recording import write_recording
from firmware_link.emulator import Cause
from firmware_link.emulator.process import RunningEmulator, run_emulator
from tactable.rig.virtual_digitizer import Stroke, make_recording
from tactable.shipped import find_device
from tests.engine.made_entries import entry_of, felt_states

TACTABLE = str(Path(sys.executable).parent / "tactable")
DEVICE = find_device("reference-a")
HELD = """
[[effect]]
name = "held"
envelope = [["held", "20 dB"]]
[[rule]]
on = "touch"
effect = "held"
"""


def write_table(path: Path, frequency_hz: float, device: Device = DEVICE) -> None:
    entries = [entry_of(device, states, frequencies_hz=(frequency_hz,) * 2) for states in felt_states(device)]
    with TableWriter(path) as writer:
        writer.describe({"device_description": device.text, "device_fingerprint": device.fingerprint})
        write_entries(writer, entries, device)


@pytest.fixture
def emulator() -> Iterator[RunningEmulator]:
    with run_emulator() as running:
        yield running


class Run:
    """`tactable run` with a finger that rests, as long as it is wanted."""

    def __init__(self, folder: Path, emulator: RunningEmulator) -> None:
        self.emulator, self.path = emulator, folder / "bar.nc"
        write_table(self.path, 100.0)
        (folder / "held.toml").write_text(HELD, encoding="utf-8")
        write_recording(make_recording((Stroke(0.0, 600.0, 0.5, 0.5),)), folder / "resting.hid")
        words = ["bar.nc", "--touch", "resting.hid", "--port", emulator.stable_port, "--effects", "held.toml"]
        self.process = subprocess.Popen(
            [TACTABLE, "run", *words, "--reconnect", "--json"],
            cwd=folder,
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        self.wait_for_hz(100.0)

    def wait_for_hz(self, frequency_hz: float) -> None:
        """Until the firmware drives at it; nothing else ends it but the run."""
        while self.driven_hz() != frequency_hz:
            assert self.process.poll() is None, self.process.stderr and self.process.stderr.read()
            time.sleep(0.05)

    def driven_hz(self) -> float:
        log = [e for e in self.emulator.log().events if e.cause is Cause.SET and e.channels[0].amplitude]
        return round(log[-1].channels[0].frequency_hz, 2) if log else 0.0

    def say_until(self, words: str) -> str:
        assert self.process.stderr is not None
        said = ""
        while words not in said:
            line = self.process.stderr.readline()
            assert line, said
            said += line
        return said

    def end(self) -> dict[str, object]:
        self.process.send_signal(signal.SIGINT)
        told, _ = self.process.communicate()
        assert self.process.returncode == 0
        return dict(json.loads(told))


def test_a_run_changes_over_to_each_new_table_and_back(tmp_path: Path, emulator: RunningEmulator) -> None:
    run = Run(tmp_path, emulator)
    for frequency_hz in (120.0, 140.0):
        write_table(run.path, frequency_hz)
        run.wait_for_hz(frequency_hz)
    roll_back(run.path)
    run.wait_for_hz(120.0)
    summary = run.end()
    assert summary["changes_of_table"] == 3


def test_a_table_that_fails_a_check_is_refused_and_the_run_goes_on(tmp_path: Path, emulator: RunningEmulator) -> None:
    run = Run(tmp_path, emulator)
    data = bytearray(run.path.read_bytes())
    data[len(data) // 2] ^= 1
    damaged = tmp_path / "damaged"
    damaged.write_bytes(data)
    damaged.replace(run.path)
    assert "is corrupted" in run.say_until("the new table is refused")
    wide = Device.parse(DEVICE.text.replace("count = 5", "count = 4"), "bar.toml")
    write_table(run.path, 130.0, wide)
    assert "has zones I, II, III, IV" in run.say_until("start it again")
    run.path.unlink()
    time.sleep(0.5)
    assert run.driven_hz() == 100.0
    write_table(run.path, 150.0)
    run.wait_for_hz(150.0)
    assert run.end()["changes_of_table"] == 1


def test_a_run_outlives_the_process_that_looks_for_tables(tmp_path: Path, emulator: RunningEmulator) -> None:
    run = Run(tmp_path, emulator)
    found = subprocess.run(
        ["pgrep", "-P", str(run.process.pid), "-f", "firmware_link.child tactable.run.table_watch"],
        capture_output=True,
        text=True,
        check=False,
    )
    (watcher,) = (int(line) for line in found.stdout.split())
    os.kill(watcher, signal.SIGKILL)
    run.say_until("no longer watched for")
    assert run.driven_hz() == 100.0
    assert run.end()["changes_of_table"] == 0
