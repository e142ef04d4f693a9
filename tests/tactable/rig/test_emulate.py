"""The command `tactable emulate`: a port for any host, marked SIMULATED, its faults counted, and its sensor."""

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
from tactable.rig.accelerometer import (
    AccelerometerError,
    EmulatedAccelerometer,
    SensedSurface,
)
from tactable.shipped import find_device
from tests.engine.loop.rig import DEVICE
from tests.firmware_link.firmware.compiled_core import LIBRARY, make, need
from tests.tactable.cli.in_process import run_here
from tests.tactable.page.test_live_bar import plate

TACTABLE = str(Path(sys.executable).parent / "tactable")


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


def ready_link(name: str) -> Link:
    with SerialPort(name) as port:
        session = Session(Link(LinkConfiguration(2, handshake_timeout_s=60.0)), port, time.monotonic_ns)
        session.connect()
        while session.link.state is not LinkState.READY:
            session.exchange()
            time.sleep(0.001)
        return session.link


@pytest.mark.machine(stall_s=None)
def test_either_core_is_listed_as_simulated_and_any_host_can_open_it_by_its_link_and_it_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    need("make", "cc")
    make(tmp_path, "host")
    words = ["--device", "reference-a", "--seed", "3", "--faults", "at_noise"]
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    device = find_device("reference-a")
    for name, core in (("python", ()), ("c", ("--core", str(tmp_path / LIBRARY)))):
        link = tmp_path / name
        with emulator(tmp_path, *words, "--link", str(link), *core) as running:
            told = running.line()
            listed = run_here(tmp_path, "list", "--json")
            capabilities = ready_link(told["stable_name"]).capabilities
            assert str(link.readlink()) == told["port"]
            summary = running.end()
        assert told["simulated"]
        assert (told["number_of_actuators"], told["seed"], told["stable_name"]) == (2, 3, str(link))
        (row,) = (row for row in json.loads(listed.stdout)["serial_ports"] if row["path"] == told["port"])
        assert row["simulated"]
        assert capabilities is not None
        assert capabilities.full_scales_m == pytest.approx([actuator.full_scale_m for actuator in device.actuators])
        assert summary["boots"][0]["ok"] > 16
        assert summary["faults"]["at_noises"] == 1
        assert not link.is_symlink() and not list((tmp_path / "tactable").iterdir())


def test_the_faults_explain_themselves(tmp_path: Path) -> None:
    told = run_here(tmp_path, "emulate", "--faults", "help")
    assert told.returncode == 0 and "reboot=" in told.stdout


def test_a_point_on_the_surface_is_taken_and_one_beside_it_refused() -> None:
    for device, here, beside in (
        (DEVICE, "at=50mm", ("at=50 x 20 mm", "at=900mm")),
        (plate(), "at=0 x 120 mm", ("at=50mm", "at=50 x 121 mm")),
    ):
        SensedSurface(device, EmulatedAccelerometer.parse(here), 1)
        for text in beside:
            with pytest.raises(AccelerometerError, match=f"off the {device.surface.kind}"):
                SensedSurface(device, EmulatedAccelerometer.parse(text), 1)
