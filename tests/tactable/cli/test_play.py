"""The command `play`: one drive by hand, on an emulated firmware, and how it refuses."""

import json
import signal
from pathlib import Path

import pytest

from firmware_link.emulator.drive_log import Cause
from firmware_link.emulator.emulator_process import run_emulator
from tests.tactable.cli.in_process import Line, run_here
from tests.tools.processes import started

DRIVE = ("--frequency", "150,130", "--amplitude", "20 %,5 %", "--phase", "0deg,90deg")


def test_a_drive_is_played_for_its_time_and_its_levels_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    line = Line()
    monkeypatch.setattr("engine.loop.loop.SystemClock", lambda: line)
    monkeypatch.setattr("tactable.audio.port.open_port", lambda *_: line)
    done = run_here(tmp_path, "play", "reference-a", "--port", "bar", *DRIVE, "--for", "0.1 s", "--json")
    assert done.returncode == 0, done.stderr
    assert "SIMULATED firmware" in done.stderr
    summary = json.loads(done.stdout)
    assert summary["simulated_firmware"]
    assert summary["duration_s"] == pytest.approx(0.1, abs=1e-3)
    assert len(summary["simulated_bar"]["level_db"]) == len(summary["simulated_bar"]["position_m"]) == 11
    events = line.log
    assert [round(channel.frequency_hz) for channel in events[0].channels] == [150, 130]
    assert not any(channel.amplitude for channel in events[-1].channels)


@pytest.mark.machine
def test_ctrl_c_silences(tmp_path: Path) -> None:
    with run_emulator() as emulator:
        words = ("play", "reference-a", "--port", emulator.port, "--frequency", "150", "--amplitude", "20 %")
        with started(tmp_path, *words) as process:
            assert process.stderr is not None
            assert "Ctrl-C ends" in process.stderr.readline()
            while not emulator.log().events:
                assert process.poll() is None
            process.send_signal(signal.SIGINT)
            out, _ = process.communicate()
        events = emulator.stop().events
    assert process.returncode == 0
    assert "then silent" in out
    assert not any(channel.amplitude for channel in events[-1].channels)
    assert events[-1].cause in (Cause.STOP, Cause.SILENT_HOST)
