"""The control channel end to end: a run on an emulated firmware, and programs at its Unix socket."""

import json
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

import tactable
from engine.touch.sources.recording import write_recording
from firmware_link.emulator import Cause
from firmware_link.emulator.process import RunningEmulator, run_emulator
from tactable.control.client import Client, ClientError
from tactable.control.osc_codec import decode_osc, encode_osc
from tactable.shipped import find_device
from tests.engine.made_table import write_table
from tests.tactable.rig.strokes import Stroke, make_recording

pytestmark = pytest.mark.machine

ROOT = Path(__file__).parents[3]
TACTABLE = str(Path(sys.executable).parent / "tactable")
DEVICE = find_device("reference-a")
NO_RULES = '[[effect]]\nname = "none"\nenvelope = [["held", "quiet"]]\n[[rule]]\non = "touch"\neffect = "none"\n'


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A table, a rule file by which nothing is felt, and a finger that rests at 20 % of the bar for ten minutes."""
    folder = tmp_path_factory.mktemp("control")
    write_table(folder / "bar.nc", DEVICE, response=0.05)
    (folder / "none.toml").write_text(NO_RULES, encoding="utf-8")
    write_recording(make_recording((Stroke(0.0, 600.0, 0.2, 0.2),)), folder / "rests.hid")
    return folder


@dataclass
class Running:
    process: "subprocess.Popen[str]"
    emulator: RunningEmulator
    socket: Path
    said: str
    """What it printed until it began."""

    def connect(self, **more: float) -> Client:
        return tactable.connect(self.socket, name="a test", lease_s=more.get("lease_s"))

    def played(self) -> list[str]:
        """What the device played: "drive", "silence" or "click"."""
        played = []
        for event in self.emulator.log().events:
            if event.cause in (Cause.SET, Cause.PLAY):
                sounds = any(channel.amplitude for channel in event.channels)
                played.append("click" if event.waveform is not None else "drive" if sounds else "silence")
        return played

    def end(self) -> dict[str, object]:
        """The summary."""
        self.process.send_signal(signal.SIGINT)
        told, said = self.process.communicate()
        assert self.process.returncode == 0, said
        return dict(json.loads(told))


@pytest.fixture(scope="module")
def running(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    """A run with a finger that rests, once that has come; its programs leave it as they found it."""
    with run_emulator() as emulator, started(folder, tmp_path_factory.mktemp("run"), emulator, "--no-watch") as running:
        with running.connect() as client:
            if not client.subscribe("touches"):
                next(client.events(30.0))
        yield running


@contextmanager
def started(folder: Path, tmp_path: Path, emulator: RunningEmulator, *more: str) -> Iterator[Running]:
    path = tmp_path / "control.sock"
    words = ["bar.nc", "--touch", "rests.hid", "--port", emulator.port, "--reconnect", "--effects", "none.toml"]
    command = [TACTABLE, "run", *words, "--json", "--control", "--control-socket", str(path), *more]
    with subprocess.Popen(command, cwd=folder, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stderr is not None
        said = ""
        while "Ctrl-C ends" not in said:
            line = process.stderr.readline()
            assert process.poll() is None and line
            said += line
        yield Running(process, emulator, path, said)
        if process.poll() is None:
            process.kill()


def finger_of(client: Client) -> int:
    (finger,) = client.subscribe("touches", "played")
    number = finger["finger"]
    assert isinstance(number, int)
    return number


def test_a_program_triggers_an_effect_and_hears_what_was_played(running: Running) -> None:
    with running.connect() as client:
        assert client.run["device"] == "reference-a" and "press" in client.run["effects"]
        finger = finger_of(client)
        client.trigger("buzz", finger=finger)
        event = next(each for each in client.events(30.0) if each["event"] == "played")
        assert (event["kind"], event["level_db"]) == ("drive", 20.0)
        assert not event["promise"]["is_achieved"] and event["promise"]["felt_db"]["nominal"] < 20.0  # a weak table
        assert event["promise"]["threshold"] == client.run["threshold"]
        assert [(each["finger"], each["role"]) for each in event["fingers"]] == [(finger, "felt")]
        client.stop()
        assert next(each for each in client.events(30.0) if each["event"] == "played")["kind"] == "silence"
        until_s = time.monotonic() + 30.0  # the event is sent when the frame is written, before the device has it
        while running.played()[-2:] != ["drive", "silence"]:
            assert time.monotonic() < until_s
            time.sleep(0.01)
        with pytest.raises(ClientError, match=r"trigger.finger: 77: does not touch the bar; of these that do: \d"):
            client.trigger("buzz", finger=77)


def test_the_example_of_two_buttons_sees_the_finger_on_one_of_them(running: Running) -> None:
    command = [sys.executable, str(ROOT / "examples" / "program_with_buttons.py"), str(running.socket)]
    with subprocess.Popen(command, text=True, stdout=subprocess.PIPE) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == "touched: OK\n"
        program.terminate()


def test_without_a_run_there_is_an_error_with_a_remedy(tmp_path: Path) -> None:
    with pytest.raises(ClientError, match=r"nobody.sock: no run listens there .*tactable run ... --control"):
        tactable.connect(tmp_path / "nobody.sock")


def test_a_second_run_does_not_take_the_socket(running: Running, folder: Path) -> None:
    with run_emulator() as emulator:
        words = ["bar.nc", "--touch", "rests.hid", "--port", emulator.port, "--control"]
        command = [TACTABLE, "run", *words, "--control-socket", str(running.socket)]
        done = subprocess.run(command, cwd=folder, text=True, capture_output=True, check=False)
    assert done.returncode == 1 and "another run listens there" in done.stderr
    with running.connect() as client:
        assert client.run["device"] == "reference-a"


@pytest.mark.long
def test_a_run_listens_to_open_sound_control_where_it_says(folder: Path, tmp_path: Path) -> None:
    with run_emulator() as emulator, started(folder, tmp_path, emulator, "--control-osc", "0") as running:
        found = re.search(r"osc://127\.0\.0\.1:(\d+)/tactable/", running.said)
        assert found is not None, running.said
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as program:
            program.connect(("127.0.0.1", int(found[1])))
            program.send(encode_osc("/tactable/ping", []))
            assert decode_osc(program.recv(1 << 16)) == [("/tactable/answer", ["/tactable/ping", True, ""])]
        running.end()
        assert not running.socket.exists()  # the control process ended by itself


def test_after_a_change_of_table_programs_meet_the_new_device(folder: Path, tmp_path: Path) -> None:
    for name in ("bar.nc", "rests.hid", "none.toml"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    longer = DEVICE.with_values({"bar.length": "350 mm"})
    with run_emulator() as emulator, started(tmp_path, tmp_path, emulator) as running:
        with running.connect() as client:
            client.subscribe("touches")
            client.set_region("kept", ["100 mm", "140 mm"], touch="press", stays=True)
        write_table(tmp_path / "new.nc", longer, response=0.05)
        (tmp_path / "new.nc").replace(tmp_path / "bar.nc")
        until_s = time.monotonic() + 60.0
        while True:
            with running.connect() as client:
                if client.run["length_m"] == longer.bar.length_m:
                    break
            assert time.monotonic() < until_s, "the table was not taken over"
        with running.connect() as client:
            assert [zone["stop_m"] for zone in client.run["zones"]] == [zone.stop_m for zone in longer.zones]
            assert client.run["regions"] == ["kept"]  # it keeps its metres
            (finger,) = client.subscribe("touches", "played")
            while finger["at_m"] != pytest.approx(0.2 * longer.bar.length_m, abs=1e-4):  # the run is a moment later
                finger = next(each["fingers"][0] for each in client.events(30.0) if each["event"] == "touches")
            assert finger["zone"] == longer.zones[1].name and finger["region"] is None
            client.set_region("key", ["15 %", "25 %"], hold={"effect": "buzz", "after": "10 ms"})
            played = next(each for each in client.events(30.0) if each["event"] == "played")
            assert played["kind"] == "drive" and played["promise"] is not None
            assert client.subscribe("played")[0]["region"] == "key"
            client.remove_region("key")
            assert next(each for each in client.events(30.0) if each["event"] == "played")["kind"] == "silence"
        summary = running.end()
        # Two regions that were set, one that was taken away, and the end of one program, perhaps of the other one, too.
        assert summary["changes_of_table"] == 1 and summary["control_steps"] in (4, 5)
        assert not running.socket.exists()
