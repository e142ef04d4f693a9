"""The commands `run`, in virtual time and on the machine, and `play`: what is played, told and refused."""

import json
import signal
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from base.errors import TactableError
from engine.effects.rules import Drives
from engine.loop.ring import Record, RingReader
from engine.table import TableError
from engine.touch import DigitizerError
from engine.touch.sources.recording import RecordingError, write_recording
from firmware_link.emulator.drive_log import Cause, DriveEvent
from firmware_link.emulator.emulator_process import EmulatorLog, RunningEmulator, run_emulator
from firmware_link.protocol.link_errors import LinkError
from tactable.cli import run
from tactable.cli.main import app
from tactable.cli.options import read_rules
from tactable.doctor.touch_check import Machine
from tactable.shipped import find_device
from tests.engine.made_table import rows_of, write_table
from tests.engine.touch.sources.fake_hid import FakeMachine
from tests.tactable.cli.in_process import Line, run_here
from tests.tactable.rig.strokes import Stroke, make_recording
from tests.tactable.rules import HELD
from tests.tools.processes import started
from tests.tools.virtual import MS

DEVICE = find_device("reference-a")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A table of a bar that does not reach 20 dB, rules, and a finger in zone I, then one in III."""
    folder = tmp_path_factory.mktemp("run")
    write_table(folder / "bar.nc", DEVICE, response=0.05, rows=rows_of(DEVICE))
    (folder / "held.toml").write_text(HELD, encoding="utf-8")
    (folder / "zones.toml").write_text(f'drives = "zones"\n{HELD}', encoding="utf-8")
    (folder / "wrong.toml").write_text(HELD.replace("on =", 'zones = ["VI"]\non ='), encoding="utf-8")
    strokes = (Stroke(0.0, 0.2, 0.1, 0.1), Stroke(0.3, 0.5, 0.5, 0.5))
    write_recording(make_recording(strokes), folder / "two.hid")
    write_recording(make_recording((Stroke(0.0, 600.0, 0.5, 0.5),)), folder / "resting.hid")
    return folder


@pytest.fixture
def line(monkeypatch: pytest.MonkeyPatch) -> Line:
    """The clock and the port of each run in this process."""
    line = Line()
    monkeypatch.setattr(run, "SystemClock", lambda: line)
    monkeypatch.setattr(run, "open_port", lambda *_: line if line.is_open else line.open())
    return line


def sounds(events: Sequence[DriveEvent]) -> list[bool]:
    return [any(channel.amplitude for channel in event.channels) for event in events]


def drives_of(events: Sequence[DriveEvent]) -> set[tuple[tuple[float, float], ...]]:
    """Frequency and amplitude of each actuator, of every drive that a command began and that sounds."""
    begun = [event.channels for event in events if event.cause is Cause.SET and sounds([event])[0]]
    return {tuple((channel.frequency_hz, channel.amplitude) for channel in channels) for channels in begun}


def played(folder: Path, *words: str, touch: str = "two.hid", status: int = 0) -> tuple[dict[str, Any], str]:
    """The summary of a run in virtual time, by the Python loop, and what was said beside."""
    paths = ("bar.nc", "--touch", touch, "--port", "bar", "--no-watch", "--no-fast-path", "--json")
    done = run_here(folder, "run", *paths, "--realtime", "none", *words)
    assert done.returncode == status, done.stderr
    return json.loads(done.stdout), done.stderr


def test_touches_of_a_recording_are_played_and_counted(folder: Path, line: Line) -> None:
    summary, said = played(folder)
    assert summary["reports"] == summary["touch_frames"] == 52
    assert summary["state_changes"] == summary["commands_sent"] == 4
    assert (summary["not_achieved"], summary["losses_of_the_port"]) == (2, 0)
    assert summary["simulated_firmware"] and "SIMULATED" in said
    assert sounds(line.log) == [True, False] * 2


@pytest.mark.parametrize(("when", "played_fingers"), [(["--refuse-not-achieved"], 0), ([], 2)])
def test_what_is_not_achieved_is_refused_or_played(
    folder: Path, line: Line, when: list[str], played_fingers: int
) -> None:
    summary, _ = played(folder, *when, "--rules", "held.toml")
    assert summary["not_achieved"] == 2
    assert sounds(line.log) == [True, False] * played_fingers


def test_zones_play_rows_of_the_sweep_in_place_of_clicks(folder: Path, line: Line) -> None:
    summary, said = played(folder, "--drives", "zones")
    # The rows reach the level, which no drive for positions does on this bar.
    assert (summary["clicks"], summary["not_achieved"]) == (0, 0) and "no clicks" not in said
    assert sounds(line.log) == [True, False] * 2


def test_the_option_replaces_what_the_file_says(folder: Path) -> None:
    found = [read_rules(folder / "zones.toml", DEVICE, drives).drives for drives in (None, "positions", "zones")]
    assert found == [Drives.ZONES, Drives.POSITIONS, Drives.ZONES]


def test_what_was_done_is_told_even_when_the_port_is_lost(folder: Path, line: Line) -> None:
    line.cable_pulled_ns = line.time_ns + 300 * MS
    line.cable_back_ns = line.cable_pulled_ns + 300 * MS
    summary, said = played(folder, "--rules", "held.toml", touch="resting.hid", status=1)
    assert summary["touches"].endswith("(SIMULATED)") and summary["duration_s"] >= 0.2
    assert said.splitlines()[-1].startswith("tactable: ")
    assert sounds(line.log) == [True, False]


def test_a_run_that_reconnects_plays_on_when_the_port_is_back(folder: Path, line: Line) -> None:
    line.cable_pulled_ns = line.time_ns + 300 * MS
    line.cable_back_ns = line.cable_pulled_ns + 300 * MS
    words = ("--reconnect", "--for", "1.5", "--rules", "held.toml")
    summary, said = played(folder, *words, touch="resting.hid")
    assert (summary["losses_of_the_port"], summary["reconnects"]) == (1, 1)
    assert "is lost, and looked for" in said and "is open again" in said
    assert sounds(line.log) == [True, False] * 2
    assert len(drives_of(line.log)) == 1, "another drive is played after the loss"


@pytest.mark.parametrize(
    ("words", "error", "parts"),
    [
        ("bar.nc --touch no-such-panel", DigitizerError, ["no-such-panel", "tactable list"]),
        ("missing.nc --touch simulated", TableError, ["missing.nc", "tactable build"]),
        ("bar.nc --touch simulated --device reference-d", TableError, ["bar.nc", "is a table of", "reference-d"]),
        ("bar.nc --touch simulated --rules missing.toml", OSError, ["missing.toml"]),
        ("bar.nc --touch simulated --rules wrong.toml", TactableError, ["wrong.toml", "'VI'"]),
        ("bar.nc --touch held.toml", RecordingError, ["held.toml"]),
        ("bar.nc --touch simulated", LinkError, ["no-such-port", "tactable list"]),
        ("bar.nc --touch simulated --realtime nice", SystemExit, []),
    ],
)
def test_a_refusal_names_the_thing_before_kernels_are_compiled(
    folder: Path, monkeypatch: pytest.MonkeyPatch, words: str, error: type[Exception], parts: list[str]
) -> None:
    monkeypatch.chdir(folder)
    compiled = list[object]()
    monkeypatch.setattr(run, "compile_steady_solver", compiled.append)
    machine = Machine(FakeMachine(folder).system, lambda: None, lambda: ())
    found = CliRunner().invoke(app, ["run", *words.split(), "--port", "no-such-port"], obj=machine).exception
    assert isinstance(found, error)
    assert compiled == []
    assert all(part in str(found) for part in parts)


def wait_for(emulator: RunningEmulator, sets: int) -> EmulatorLog:
    """Until the firmware has begun so many drives that sound; nothing else ends it but the run."""
    while True:
        log = emulator.log()
        if sum(sounds([event for event in log.events if event.cause is Cause.SET])) >= sets:
            return log
        time.sleep(0.05)


@pytest.mark.machine(stall_s=None)
def test_an_unplugged_device_plays_on_under_another_name_and_ctrl_c_ends_the_run(folder: Path, tmp_path: Path) -> None:
    ring = tmp_path / "ring"
    with run_emulator() as emulator:
        before = Path(emulator.stable_port).readlink()
        paths = ("bar.nc", "--touch", "resting.hid", "--port", emulator.stable_port, "--ring", str(ring))
        with started(folder, "run", *paths, "--reconnect", "--rules", "held.toml", "--json") as process:
            assert process.stderr is not None
            while "Ctrl-C ends" not in process.stderr.readline():
                assert process.poll() is None
            with RingReader(ring, from_start=True) as reader:
                sounded = len(wait_for(emulator, 1).events)
                emulator.unplug()
                log = wait_for(emulator, sounded + 1)
                records = list[Record]()
                while len(records) < 20:
                    records += reader.read()
            process.send_signal(signal.SIGINT)
            told, said = process.communicate()
        assert process.returncode == 0, said
        assert Path(emulator.stable_port).readlink() != before, "the port came back under the same name"
        summary = json.loads(told)
        assert summary["losses_of_the_port"] >= 1 and summary["reconnects"] >= 1
        assert f"{emulator.stable_port} is open again" in said
        # A stall of this machine may have ended the drive before the cable did.
        assert {Cause.HUNG_UP, Cause.LEASE_EXPIRED} & {event.cause for event in log.events}
        assert len(drives_of(log.events)) == 1, "another drive is played after the loss"
        assert not sounds(emulator.stop().events)[-1], "the end of a run is not silence"
    assert [record.report_index for record in records if record.report][:3] == [0, 1, 2]
    assert any(record.touches for record in records)
    assert not ring.exists(), "the ring stays behind"


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
