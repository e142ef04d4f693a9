"""The control channel end to end: a run on an emulated firmware, and programs at its Unix socket."""

import json
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import tactable
from engine.touch.sources.recording import write_recording
from firmware_link.emulator import Cause
from firmware_link.emulator.process import RunningEmulator, run_emulator
from tactable.control.client import Client
from tactable.control.osc_codec import decode_osc, encode_osc
from tactable.shipped import find_device
from tests.engine.made_table import write_table
from tests.tactable.cli.in_process import run_here
from tests.tactable.rig.strokes import Stroke, make_recording

pytestmark = pytest.mark.machine

ROOT = Path(__file__).parents[3]
TACTABLE = str(Path(sys.executable).parent / "tactable")
DEVICE = find_device("reference-a")
NO_RULES = '[[effect]]\nname = "none"\nenvelope = [["held", "quiet"]]\n[[rule]]\non = "touch"\neffect = "none"\n'
PATIENCE_S = 60.0


@dataclass
class Running:
    process: "subprocess.Popen[str]"
    emulator: RunningEmulator
    socket: Path
    said: str
    """What it printed until it began."""

    def connect(self) -> Client:
        return tactable.connect(self.socket, name="a test")

    def greeting(self) -> dict[str, Any]:
        """What another program is told of the run."""
        with self.connect() as client:
            return client.run

    def played(self) -> list[str]:
        """What the device played: "drive", "silence" or "click"."""
        played = []
        for event in self.emulator.log().events:
            if event.cause in (Cause.SET, Cause.PLAY):
                sounds = any(channel.amplitude for channel in event.channels)
                played.append("click" if event.waveform is not None else "drive" if sounds else "silence")
        return played

    def end(self) -> dict[str, Any]:
        """The summary."""
        self.process.send_signal(signal.SIGINT)
        told, said = self.process.communicate()
        assert self.process.returncode == 0, said
        return dict(json.loads(told))


@pytest.fixture
def running(tmp_path: Path) -> Iterator[Running]:
    """A run by whose rules nothing is felt, and a finger that rests at 20 % of the bar for ten minutes."""
    write_table(tmp_path / "bar.nc", DEVICE, response=0.05)
    (tmp_path / "none.toml").write_text(NO_RULES, encoding="utf-8")
    write_recording(make_recording((Stroke(0.0, 600.0, 0.2, 0.2),)), tmp_path / "rests.hid")
    path = tmp_path / "control.sock"
    with run_emulator() as emulator:
        words = ["bar.nc", "--touch", "rests.hid", "--port", emulator.port, "--reconnect", "--effects", "none.toml"]
        control = ["--json", "--control", "--control-socket", str(path), "--control-osc", "0"]
        with subprocess.Popen(
            [TACTABLE, "run", *words, *control], cwd=tmp_path, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        ) as process:
            assert process.stderr is not None
            said = ""
            while "Ctrl-C ends" not in said:
                line = process.stderr.readline()
                assert process.poll() is None and line, said
                said += line
            yield Running(process, emulator, path, said)
            if process.poll() is None:
                process.kill()


def event_of(client: Client, name: str, has: Callable[[dict[str, Any]], bool] = lambda _: True) -> dict[str, Any]:
    """The next event of this name that has something."""
    return next(each for each in client.events(PATIENCE_S) if each["event"] == name and has(each))


def wait_until(holds: Callable[[], bool]) -> None:
    until_s = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < until_s, "it does not come to pass"
        time.sleep(0.02)


def test_a_run_serves_programs_from_its_first_touch_over_a_new_table_to_its_end(running: Running) -> None:
    triggers_and_hears(running)
    the_example_of_two_buttons_sees_the_finger(running)
    no_second_run_takes_the_socket(running)
    answers_open_sound_control_where_it_says(running)
    programs_meet_the_device_of_a_new_table(running)
    summary = running.end()
    assert summary["changes_of_table"] == 1 and summary["control_steps"] > 8
    assert not running.socket.exists()  # the control process ended by itself


def triggers_and_hears(running: Running) -> None:
    with running.connect() as client:
        assert client.run["device"] == "reference-a" and "press" in client.run["effects"]
        (finger,) = client.subscribe("touches", "played") or event_of(client, "touches")["fingers"]
        client.trigger("buzz", finger=finger["finger"])
        event = event_of(client, "played")
        assert (event["kind"], event["level_db"]) == ("drive", 20.0)
        assert not event["promise"]["is_achieved"] and event["promise"]["felt_db"]["nominal"] < 20.0  # a weak table
        assert event["promise"]["threshold"] == client.run["threshold"]
        assert [(each["finger"], each["role"]) for each in event["fingers"]] == [(finger["finger"], "felt")]
        client.stop()
        assert event_of(client, "played")["kind"] == "silence"
        # The event is sent when the frame is written, before the device has it.
        wait_until(lambda: running.played()[-2:] == ["drive", "silence"])


def the_example_of_two_buttons_sees_the_finger(running: Running) -> None:
    command = [sys.executable, str(ROOT / "examples" / "program_with_buttons.py"), str(running.socket)]
    with subprocess.Popen(command, text=True, stdout=subprocess.PIPE) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == "touched: OK\n"
        program.terminate()


def no_second_run_takes_the_socket(running: Running) -> None:
    with run_emulator() as emulator:
        words = ["bar.nc", "--touch", "rests.hid", "--port", emulator.port, "--control"]
        done = run_here(running.socket.parent, "run", *words, "--control-socket", str(running.socket))
    assert done.returncode == 1 and "another run listens there" in done.stderr
    assert running.greeting()["device"] == "reference-a"


def answers_open_sound_control_where_it_says(running: Running) -> None:
    found = re.search(r"osc://127\.0\.0\.1:(\d+)/tactable/", running.said)
    assert found is not None, running.said
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as program:
        program.connect(("127.0.0.1", int(found[1])))
        program.send(encode_osc("/tactable/ping", []))
        assert decode_osc(program.recv(1 << 16)) == [("/tactable/answer", ["/tactable/ping", True, ""])]


def programs_meet_the_device_of_a_new_table(running: Running) -> None:
    with running.connect() as client:
        client.set_region("kept", ["100 mm", "140 mm"], touch="press", stays=True)
    longer = DEVICE.with_values({"bar.length": "350 mm"})
    folder = running.socket.parent
    write_table(folder / "new.nc", longer, response=0.05)
    (folder / "new.nc").replace(folder / "bar.nc")
    wait_until(lambda: running.greeting()["length_m"] == longer.bar.length_m)
    with running.connect() as client:
        assert [zone["stop_m"] for zone in client.run["zones"]] == [zone.stop_m for zone in longer.zones]
        assert client.run["regions"] == ["kept"]  # it keeps its metres
        at_m = pytest.approx(0.2 * longer.bar.length_m, abs=1e-4)
        (finger,) = client.subscribe("touches", "played")
        if finger["at_m"] != at_m:  # the run is a moment later
            (finger,) = event_of(client, "touches", lambda event: bool(event["fingers"][0]["at_m"] == at_m))["fingers"]
        assert finger["zone"] == longer.zones[1].name and finger["region"] is None
        client.set_region("key", ["15 %", "25 %"], hold={"effect": "buzz", "after": "10 ms"})
        played = event_of(client, "played")
        assert played["kind"] == "drive" and played["promise"] is not None
        assert client.subscribe("played")[0]["region"] == "key"
        client.remove_region("key")
        assert event_of(client, "played")["kind"] == "silence"
