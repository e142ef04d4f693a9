"""A real `tactable run` on an emulated board that plays strokes and takes messages of programs. SIMULATED."""

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from engine.touch.sources.recording import Recording, write_recording
from firmware_link.emulator.emulator_process import RunningEmulator, run_emulator
from tactable.shipped import find_device
from tests.engine.made_table import write_table

DEVICE = find_device("reference-a")


class ControlledRun(NamedTuple):
    """The process, its board, its control socket, and what it said before it played."""

    process: "subprocess.Popen[str]"
    emulator: RunningEmulator
    socket: Path
    said: str

    def summary(self) -> dict[str, Any]:
        """What it says once it has ended."""
        told, said = self.process.communicate(timeout=60.0)
        assert self.process.returncode == 0, said
        return dict(json.loads(told))


@contextmanager
def controlled_run(recording: Recording, *words: str) -> Iterator[ControlledRun]:
    with tempfile.TemporaryDirectory() as name, run_emulator() as emulator:
        folder, command = Path(name), [str(Path(sys.executable).parent / "tactable"), "run", "bar.nc", *words]
        write_table(folder / "bar.nc", DEVICE, response=0.05)
        write_recording(recording, folder / "taps.hid")
        command += ["--touch", "taps.hid", "--port", emulator.port, "--reconnect", "--json"]
        command += ["--control", "--control-socket", "control.sock"]
        pipe, said = subprocess.PIPE, ""
        with subprocess.Popen(command, cwd=folder, text=True, stdout=pipe, stderr=pipe) as process:
            assert process.stderr is not None
            while "Ctrl-C ends" not in said:
                said += (line := process.stderr.readline())
                assert line and process.poll() is None, said
            try:
                yield ControlledRun(process, emulator, folder / "control.sock", said)
            finally:
                process.kill()
