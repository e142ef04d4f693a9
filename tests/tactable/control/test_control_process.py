"""The control channel end to end: a run on an emulated firmware, and programs at its Unix socket."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

import tactable
from engine.touch.sources.recording import write_recording
from firmware_link.emulator.drive_log import Cause
from firmware_link.emulator.emulator_process import RunningEmulator, run_emulator
from tactable.control.client import Client
from tactable.shipped import find_device
from tests.engine.made_table import write_table
from tests.tactable.rig.strokes import Stroke, make_recording
from tests.tools.processes import started

pytestmark = pytest.mark.machine

ROOT = Path(__file__).parents[3]
NO_RULES = '[[effect]]\nname = "none"\nenvelope = [["held", "quiet"]]\n[[rule]]\non = "touch"\neffect = "none"\n'
PATIENCE_S = 60.0
DEVICE = find_device("reference-a")


class ControlledRun(NamedTuple):
    """The process, its board, its control socket, and what it said before it played."""

    process: "subprocess.Popen[str]"
    emulator: RunningEmulator
    socket: Path
    said: str


def connected(run: ControlledRun) -> Client:
    return tactable.connect(run.socket, name="a test")


def played(run: ControlledRun) -> list[str]:
    """What the device played: "drive", "silence" or "click"."""
    events = [event for event in run.emulator.log().events if event.cause in (Cause.SET, Cause.PLAY)]
    drives = ["drive" if any(each.amplitude for each in event.channels) else "silence" for event in events]
    return ["click" if event.waveform is not None else drive for event, drive in zip(events, drives, strict=True)]


@pytest.fixture
def running(tmp_path: Path) -> Iterator[ControlledRun]:
    """A run by whose rules nothing is felt, and a finger that rests at 20 % of the bar for ten minutes."""
    (tmp_path / "none.toml").write_text(NO_RULES, encoding="utf-8")
    write_table(tmp_path / "bar.nc", DEVICE, response=0.05)
    write_recording(make_recording((Stroke(0.0, 600.0, 0.2, 0.2),)), tmp_path / "taps.hid")
    words = ["--touch", "taps.hid", "--rules", "none.toml", "--reconnect", "--json"]
    words += ["--control", "--control-socket", "control.sock", "--control-osc", "0"]
    with run_emulator() as emulator:
        said = ""
        with started(tmp_path, "run", "bar.nc", "--port", emulator.port, *words) as process:
            assert process.stderr is not None
            while "Ctrl-C ends" not in said:
                said += (line := process.stderr.readline())
                assert line and process.poll() is None, said
            try:
                yield ControlledRun(process, emulator, tmp_path / "control.sock", said)
            finally:
                process.kill()


def event_of(client: Client, name: str) -> dict[str, Any]:
    """The next event of this name."""
    return next(each for each in client.events(PATIENCE_S) if each["event"] == name)


def wait_until(holds: Callable[[], bool]) -> None:
    until_s = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < until_s, "it does not come to pass"
        time.sleep(0.02)


def test_a_run_serves_programs_from_its_first_touch_to_its_end(running: ControlledRun) -> None:
    assert "osc://127.0.0.1:" in running.said
    triggers_and_hears(running)
    the_example_of_two_buttons_sees_the_finger(running)
    running.process.send_signal(signal.SIGINT)
    told, said = running.process.communicate(timeout=PATIENCE_S)
    assert running.process.returncode == 0, said
    assert json.loads(told)["control_steps"] > 4
    assert not running.socket.exists()  # the control process ended by itself


def triggers_and_hears(running: ControlledRun) -> None:
    with connected(running) as client:
        assert client.run["device"] == "reference-a" and "press" in client.run["effects"]
        (finger,) = client.subscribe("touches", "played") or event_of(client, "touches")["fingers"]
        client.trigger("buzz", finger=finger["finger"])
        event = event_of(client, "played")
        assert (event["kind"], event["effect"], event["level_db"]) == ("drive", "buzz", 20.0)
        assert not event["promise"]["is_achieved"] and event["promise"]["felt_db"]["nominal"] < 20.0  # a weak table
        assert event["promise"]["threshold"] == client.run["threshold"]
        assert [(each["finger"], each["role"]) for each in event["fingers"]] == [(finger["finger"], "felt")]
        client.stop()
        event = event_of(client, "played")
        assert (event["kind"], event["effect"]) == ("silence", None)
        # The event is sent when the frame is written, before the device has it.
        wait_until(lambda: played(running)[-2:] == ["drive", "silence"])


def the_example_of_two_buttons_sees_the_finger(running: ControlledRun) -> None:
    command = [sys.executable, str(ROOT / "examples" / "program_with_buttons.py"), str(running.socket)]
    with subprocess.Popen(command, text=True, stdout=subprocess.PIPE) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == "touched: OK\n"
        program.terminate()
