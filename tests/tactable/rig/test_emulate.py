"""The command `tactable emulate`: a port for any host, marked SIMULATED, with faults that are counted."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from firmware_link.host.link import Link
from firmware_link.host.link_values import LinkConfiguration, LinkState
from firmware_link.host.serial_port import SerialPort
from firmware_link.host.session import Session
from tactable.rig.emulate import configuration_of
from tactable.shipped import find_device
from tests.firmware_link.firmware.compiled_core import LIBRARY, make, need
from tests.tactable.cli.in_process import run_here

TACTABLE = str(Path(sys.executable).parent / "tactable")
PATIENCE_S = 60.0


class Emulator:
    """The running command, its lines as JSON."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self._process = process

    def line(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        document: dict[str, Any] = json.loads(self._process.stdout.readline())
        return document

    def end(self) -> dict[str, Any]:
        self._process.send_signal(signal.SIGINT)
        return self.line()


@contextmanager
def emulator(tmp_path: Path, *words: str) -> Iterator[Emulator]:
    environment = {**os.environ, "XDG_RUNTIME_DIR": str(tmp_path)}
    command = [TACTABLE, "emulate", "--json", *words]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield Emulator(process)
        finally:
            process.kill()


def run(tmp_path: Path, *words: str) -> "subprocess.CompletedProcess[str]":
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
        return run_here(tmp_path, *words)


def ready_link(port: SerialPort) -> Link:
    session = Session(Link(LinkConfiguration(2, handshake_timeout_s=PATIENCE_S)), port, time.monotonic_ns)
    session.connect()
    while session.link.state is not LinkState.READY:
        session.exchange()
        time.sleep(0.001)
    return session.link


@pytest.mark.machine
def test_it_is_listed_as_simulated_and_any_host_can_open_it_and_it_counts(tmp_path: Path) -> None:
    with emulator(tmp_path, "--device", "reference-a", "--seed", "3", "--faults", "at_noise") as running:
        told = running.line()
        assert told["simulated"]
        assert (told["number_of_actuators"], told["seed"]) == (2, 3)
        listing = json.loads(run(tmp_path, "list", "--json").stdout)
        (row,) = (row for row in listing["serial_ports"] if row["stable_id"] == told["stable_name"])
        assert row["simulated"]
        assert row["path"] == told["port"]
        with SerialPort(told["stable_name"]) as port:
            capabilities = ready_link(port).capabilities
        summary = running.end()
    device = find_device("reference-a")
    assert capabilities is not None
    assert capabilities.full_scales_m == pytest.approx([actuator.full_scale_m for actuator in device.actuators])
    assert summary["boots"][0]["ok"] > 16
    assert summary["faults"]["at_noises"] == 1
    assert not (tmp_path / "tactable").exists() or not list((tmp_path / "tactable").iterdir())


@pytest.mark.machine
def test_the_c_core_is_a_device_like_its_twin(tmp_path: Path) -> None:
    need("make", "cc")
    make(tmp_path, "host")
    words = ("--core", str(tmp_path / LIBRARY), "--faults", "reboot@0s")
    with emulator(tmp_path, *words) as running:
        with SerialPort(running.line()["port"]) as port:
            assert ready_link(port).capabilities is not None
        summary = running.end()
    assert [counters["ok"] > 16 for counters in summary["boots"]] == [False, True]


@pytest.mark.machine
def test_a_link_leads_to_the_port_while_it_runs_and_replaces_nothing_else(tmp_path: Path) -> None:
    link = tmp_path / "board"
    with emulator(tmp_path, "--link", str(link)) as running:
        said = running.line()
        assert said["stable_name"] == str(link)
        assert str(link.readlink()) == said["port"]
        running.end()
        assert not link.is_symlink()
    link.write_text("mine", encoding="utf-8")
    done = run(tmp_path, "emulate", "--link", str(link))
    assert done.returncode == 1
    assert "board: exists already and is no link to a port; end the emulator that has it, or choose" in done.stderr
    assert link.read_text(encoding="utf-8") == "mine"
    assert done.stderr.count("\n") == 1


def test_a_core_that_is_no_library_is_one_line_and_exit_status_1(tmp_path: Path) -> None:
    done = run(tmp_path, "emulate", "--core", str(tmp_path / "nothing.so"))
    assert done.returncode == 1
    assert "nothing.so is no library of the firmware" in done.stderr


def test_a_wrong_fault_is_one_line_and_exit_status_1(tmp_path: Path) -> None:
    done = run(tmp_path, "emulate", "--faults", "dorp=0.1")
    assert done.returncode == 1
    assert "fault 'dorp' is unknown (did you mean 'drop'?)" in done.stderr


def test_the_faults_explain_themselves(tmp_path: Path) -> None:
    done = run(tmp_path, "emulate", "--faults", "help")
    assert done.returncode == 0
    assert "reboot=0.5s@12s" in done.stdout


def test_without_a_device_there_are_two_actuators() -> None:
    assert configuration_of(None).number_of_actuators == 2
    described = configuration_of(find_device("reference-d"))
    assert described.number_of_actuators == len(described.full_scales_pm) == 2
