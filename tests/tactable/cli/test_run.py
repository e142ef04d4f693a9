"""The command `run`: from touches to an emulated firmware of another process, and how it refuses."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from engine.effects import Drives
from engine.loop import Record, RingReader
from engine.table import TableError
from engine.touch import DigitizerError
from engine.touch.sources.recording import RecordingError, read_recording, write_recording
from firmware_link.emulator import Cause
from firmware_link.emulator.process import EmulatorLog, RunningEmulator, run_emulator
from firmware_link.protocol.errors import LinkError
from tactable.cli import run
from tactable.cli.main import app
from tactable.cli.options import read_rules
from tactable.doctor.touch import Machine
from tactable.shipped import find_device
from tests.engine.made_rows import rows_of
from tests.engine.made_table import write_table
from tests.engine.touch.sources.fake_hid import FakeMachine
from tests.tactable.cli.in_process import run_here
from tests.tactable.rig.strokes import Stroke, make_recording

pytestmark = pytest.mark.machine

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


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A table of a bar that does not reach 20 dB, rules, and a finger in zone I, then one in III."""
    folder = tmp_path_factory.mktemp("run")
    write_table(folder / "bar.nc", DEVICE, response=0.05, rows=rows_of(DEVICE))
    (folder / "held.toml").write_text(HELD, encoding="utf-8")
    (folder / "wrong.toml").write_text(HELD.replace("on =", 'zones = ["VI"]\non ='), encoding="utf-8")
    strokes = (Stroke(0.0, 0.2, 0.1, 0.1), Stroke(0.3, 0.5, 0.5, 0.5))
    write_recording(make_recording(strokes), folder / "two.hid")
    return folder


@pytest.fixture
def emulator() -> Iterator[RunningEmulator]:
    with run_emulator() as running:
        yield running


def played(folder: Path, emulator: RunningEmulator, *words: str) -> tuple[dict[str, Any], list[bool] | None, str]:
    """The summary of a run in this process, whether each drive in the firmware sounded, and what was said beside.

    The second is None where the machine stalled: the firmware falls silent after 40 ms and latches after 250 ms.
    """
    paths = ("bar.nc", "--touch", "two.hid", "--port", emulator.port, "--reconnect", "--no-watch", "--json")
    done = run_here(folder, "run", *paths, *words)
    assert done.returncode == 0, done.stderr
    summary, events = json.loads(done.stdout), emulator.stop().events
    if summary["reconnects"] or summary["link"]["coalesced"] or any(e.cause is Cause.LEASE_EXPIRED for e in events):
        return summary, None, done.stderr
    return summary, [any(channel.amplitude for channel in event.channels) for event in events], done.stderr


@contextmanager
def started(folder: Path, *words: str) -> Iterator["subprocess.Popen[str]"]:
    """The command, once it plays."""
    command, pipe = [TACTABLE, "run", *words], subprocess.PIPE
    with subprocess.Popen(command, cwd=folder, text=True, stdout=pipe, stderr=pipe) as process:
        assert process.stderr is not None
        while "Ctrl-C ends" not in process.stderr.readline():
            assert process.poll() is None
        yield process


def test_touches_of_a_recording_are_played_and_counted(folder: Path, emulator: RunningEmulator) -> None:
    summary, sounds, said = played(folder, emulator)
    assert summary["reports"] == summary["touch_frames"] == 52
    assert summary["state_changes"] == 4
    assert summary["simulated_firmware"]
    assert (summary["not_achieved"], summary["provisional"]) == (2, 0)
    assert summary["commands_sent"] + summary["link"]["coalesced"] == 4
    assert sounds in (None, [True, False] * 2)
    assert "SIMULATED" in said


@pytest.mark.parametrize(("when", "played_fingers"), [("refuse", 0), ("warn", 2), ("go-on", 2)])
def test_what_is_not_achieved_is_refused_or_played(
    folder: Path, emulator: RunningEmulator, when: str, played_fingers: int
) -> None:
    summary, sounds, _ = played(folder, emulator, "--when-not-achieved", when, "--effects", "held.toml")
    assert summary["not_achieved"] == 2
    assert sounds in (None, [True, False] * played_fingers)


@pytest.mark.parametrize("rules", [("--drives", "zones"), ("--effects", "zones.toml")])
def test_zones_play_rows_of_the_sweep_in_place_of_clicks(
    folder: Path, emulator: RunningEmulator, rules: tuple[str, str]
) -> None:
    (folder / "zones.toml").write_text(f'drives = "zones"\n{HELD}', encoding="utf-8")
    summary, sounds, said = played(folder, emulator, *rules)
    # The rows reach the level, which no drive for positions does on this bar.
    assert (summary["clicks"], summary["not_achieved"]) == (0, 0) and "no clicks" not in said
    assert sounds in (None, [True, False] * 2)


def test_the_option_replaces_what_the_file_says(tmp_path: Path) -> None:
    path = tmp_path / "zones.toml"
    path.write_text(f'drives = "zones"\n{HELD}', encoding="utf-8")
    found = [read_rules(path, DEVICE, drives).drives for drives in (None, "positions", "zones")]
    assert found == [Drives.ZONES, Drives.POSITIONS, Drives.ZONES]


def test_a_run_ends_after_its_time(folder: Path, emulator: RunningEmulator) -> None:
    words = ("--touch", "simulated", "--for", "1.5", "--effects", "held.toml")
    summary, sounds, _ = played(folder, emulator, *words)
    assert summary["duration_s"] >= 1.5
    assert summary["reports"] < 692
    # Two fingers come within the time, the second of them late; the silence at the end is the last that is heard.
    assert sounds in (None, [True, False], [True, False] * 2)


def test_ctrl_c_ends_a_run_with_silence_and_its_summary(folder: Path, emulator: RunningEmulator) -> None:
    words = ["bar.nc", "--touch", "simulated", "--port", emulator.port, "--reconnect"]
    with started(folder, *words) as process:
        process.send_signal(signal.SIGINT)
        told, _ = process.communicate()
    assert process.returncode == 0
    assert "touch frames" in told
    assert not any(channel.amplitude for event in emulator.stop().events[-1:] for channel in event.channels)


def test_what_was_done_is_told_even_when_the_port_is_lost(folder: Path, emulator: RunningEmulator) -> None:
    words = ["bar.nc", "--touch", "simulated", "--port", emulator.port, "--json"]
    with started(folder, *words) as process:
        emulator.unplug()
        told, said = process.communicate()
    assert process.returncode == 1
    assert json.loads(told)["touches"].endswith("(SIMULATED)")
    assert said.splitlines()[-1].startswith("tactable: ")


def wait_for(emulator: RunningEmulator, sets: int) -> EmulatorLog:
    """Until the firmware has begun so many drives that sound; nothing else ends it but the run."""
    while True:
        log = emulator.log()
        sounding = [e for e in log.events if e.cause is Cause.SET and any(channel.amplitude for channel in e.channels)]
        if len(sounding) >= sets:
            return log
        time.sleep(0.05)


def test_an_unplugged_device_plays_on_when_it_is_back_under_another_name_and_sigterm_ends_the_run(
    folder: Path, emulator: RunningEmulator
) -> None:
    write_recording(make_recording((Stroke(0.0, 600.0, 0.5, 0.5),)), folder / "resting.hid")
    paths = ("bar.nc", "--touch", "resting.hid", "--port", emulator.stable_port)
    before = Path(emulator.stable_port).readlink()
    with started(folder, *paths, "--reconnect", "--effects", "held.toml", "--json") as process:
        sounded = len(wait_for(emulator, 1).events)
        emulator.unplug()
        log = wait_for(emulator, sounded + 1)
        process.send_signal(signal.SIGTERM)
        told, said = process.communicate()
    assert process.returncode == 0, said
    assert Path(emulator.stable_port).readlink() != before
    summary = json.loads(told)
    assert summary["losses_of_the_port"] >= 1
    assert summary["reconnects"] >= 1
    assert f"{emulator.stable_port} is open again" in said
    # A stall of this machine may have ended the drive before the cable did.
    assert {Cause.HUNG_UP, Cause.LEASE_EXPIRED} & {event.cause for event in log.events}
    drives = {event.channels for event in log.events if event.cause is Cause.SET}
    assert len({tuple((c.frequency_hz, c.amplitude) for c in channels) for channels in drives}) == 1
    assert not any(channel.amplitude for channel in emulator.stop().events[-1].channels)


@pytest.mark.parametrize(
    ("words", "error", "parts"),
    [
        (("bar.nc", "--touch", "no-such-panel"), DigitizerError, ["no-such-panel", "tactable list"]),
        (("missing.nc", "--touch", "simulated"), TableError, ["missing.nc", "tactable build"]),
        (
            ("bar.nc", "--touch", "simulated", "--device", "reference-d"),
            TableError,
            ["bar.nc", "is a table of", "reference-d"],
        ),
        (("bar.nc", "--touch", "simulated", "--effects", "missing.toml"), OSError, ["missing.toml"]),
        (("bar.nc", "--touch", "held.toml"), RecordingError, ["held.toml"]),
        (("bar.nc", "--touch", "simulated"), LinkError, ["no-such-port", "tactable list"]),
    ],
)
def test_a_refusal_names_the_thing_before_kernels_are_compiled(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
    error: type[Exception],
    parts: list[str],
) -> None:
    monkeypatch.chdir(folder)
    compiled = list[object]()
    monkeypatch.setattr(run, "compile_steady_solver", compiled.append)
    machine = Machine(FakeMachine(folder).system, lambda: None, lambda: ())
    found = CliRunner().invoke(app, ["run", *words, "--port", "no-such-port"], obj=machine).exception
    assert isinstance(found, error)
    assert compiled == []
    assert all(part in str(found) for part in parts)


def test_a_zone_that_the_device_has_not_is_refused_in_one_line(folder: Path) -> None:
    done = run_here(
        folder, "run", "bar.nc", "--touch", "simulated", "--port", "no-such-port", "--effects", "wrong.toml"
    )
    assert done.returncode == 1
    assert done.stderr.startswith("tactable: wrong.toml: rule[1].zones: 'VI': reference-a has no such zone")
    assert done.stderr.count("\n") == 1


def test_a_recording_that_cannot_be_written_is_one_line_and_status_1(folder: Path, emulator: RunningEmulator) -> None:
    words = ("bar.nc", "--touch", "two.hid", "--port", emulator.port, "--no-watch", "--record", "missing/again.hid")
    done = run_here(folder, "run", *words)
    assert done.returncode == 1
    (line,) = [line for line in done.stderr.splitlines() if line.startswith("tactable: ")]
    assert line.endswith("the recorder: missing: no such folder; create it or choose another output")


def test_another_process_records_what_is_touched(folder: Path, emulator: RunningEmulator, tmp_path: Path) -> None:
    recorded = tmp_path / "again.hid"
    summary, _, _ = played(folder, emulator, "--record", str(recorded), "--realtime", "collector")
    before, again = read_recording(folder / "two.hid"), read_recording(recorded)
    assert [report.data for report in again.reports] == [report.data for report in before.reports]
    assert (again.name, again.bus, again.descriptor) == (before.name, before.bus, before.descriptor)
    assert summary["realtime"] == [
        {"step": "collector", "finding": "collected, frozen and off", "remedy": "", "in_force": True}
    ]


def test_a_ring_shows_a_run_to_whoever_looks_and_goes_with_it(folder: Path, emulator: RunningEmulator) -> None:
    ring = folder / "ring"
    words = ["bar.nc", "--touch", "simulated", "--port", emulator.port, "--reconnect", "--ring", "ring"]
    with started(folder, *words) as process, RingReader(ring, from_start=True) as reader:
        records = list[Record]()
        while len(records) < 20:
            records += reader.read()
        process.send_signal(signal.SIGINT)
        process.communicate()
    assert [record.report_index for record in records if record.report][:3] == [0, 1, 2]
    assert any(record.touches for record in records)
    assert not ring.exists()


def test_a_step_that_is_none_is_a_usage_error(folder: Path) -> None:
    done = run_here(folder, "run", "bar.nc", "--touch", "two.hid", "--port", "/nowhere", "--realtime", "nice")
    assert done.returncode == 2
    assert "is unknown: write all, none" in " ".join(done.stderr.replace("│", " ").split())
