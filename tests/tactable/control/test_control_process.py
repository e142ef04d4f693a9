"""The control channel end to end: a run on an emulated firmware, and programs at its Unix socket."""

import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import tactable
from firmware_link.emulator.drive_log import Cause
from firmware_link.emulator.emulator_process import run_emulator
from tactable.control.client import Client
from tactable.control.osc_codec import decode_osc, encode_osc
from tests.engine.made_table import write_table
from tests.studies.trust.controlled_run import DEVICE, ControlledRun, controlled_run
from tests.tactable.cli.in_process import run_here
from tests.tactable.rig.strokes import Stroke, make_recording

pytestmark = pytest.mark.machine

ROOT = Path(__file__).parents[3]
NO_RULES = '[[effect]]\nname = "none"\nenvelope = [["held", "quiet"]]\n[[rule]]\non = "touch"\neffect = "none"\n'
PATIENCE_S = 60.0


def connected(run: ControlledRun) -> Client:
    return tactable.connect(run.socket, name="a test")


def greeting(run: ControlledRun) -> dict[str, Any]:
    """What another program is told of the run."""
    with connected(run) as client:
        return client.run


def played(run: ControlledRun) -> list[str]:
    """What the device played: "drive", "silence" or "click"."""
    events = [event for event in run.emulator.log().events if event.cause in (Cause.SET, Cause.PLAY)]
    drives = ["drive" if any(each.amplitude for each in event.channels) else "silence" for event in events]
    return ["click" if event.waveform is not None else drive for event, drive in zip(events, drives, strict=True)]


@pytest.fixture
def running(tmp_path: Path) -> Iterator[ControlledRun]:
    """A run by whose rules nothing is felt, and a finger that rests at 20 % of the bar for ten minutes."""
    (tmp_path / "none.toml").write_text(NO_RULES, encoding="utf-8")
    recording = make_recording((Stroke(0.0, 600.0, 0.2, 0.2),))
    with controlled_run(recording, "--effects", str(tmp_path / "none.toml"), "--control-osc", "0") as run:
        yield run


def event_of(client: Client, name: str, has: Callable[[dict[str, Any]], bool] = lambda _: True) -> dict[str, Any]:
    """The next event of this name that has something."""
    return next(each for each in client.events(PATIENCE_S) if each["event"] == name and has(each))


def wait_until(holds: Callable[[], bool]) -> None:
    until_s = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < until_s, "it does not come to pass"
        time.sleep(0.02)


def test_a_run_serves_programs_from_its_first_touch_over_a_new_table_to_its_end(running: ControlledRun) -> None:
    triggers_and_hears(running)
    the_example_of_two_buttons_sees_the_finger(running)
    no_second_run_takes_the_socket(running)
    answers_open_sound_control_where_it_says(running)
    programs_meet_the_device_of_a_new_table(running)
    running.process.send_signal(signal.SIGINT)
    summary = running.summary()
    assert summary["changes_of_table"] == 1 and summary["control_steps"] > 8
    assert not running.socket.exists()  # the control process ended by itself


def triggers_and_hears(running: ControlledRun) -> None:
    with connected(running) as client:
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
        wait_until(lambda: played(running)[-2:] == ["drive", "silence"])


def the_example_of_two_buttons_sees_the_finger(running: ControlledRun) -> None:
    command = [sys.executable, str(ROOT / "examples" / "program_with_buttons.py"), str(running.socket)]
    with subprocess.Popen(command, text=True, stdout=subprocess.PIPE) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == "touched: OK\n"
        program.terminate()


def no_second_run_takes_the_socket(running: ControlledRun) -> None:
    with run_emulator() as emulator:
        words = ["bar.nc", "--touch", "taps.hid", "--port", emulator.port, "--control"]
        done = run_here(running.socket.parent, "run", *words, "--control-socket", str(running.socket))
    assert done.returncode == 1 and "another run listens there" in done.stderr
    assert greeting(running)["device"] == "reference-a"


def answers_open_sound_control_where_it_says(running: ControlledRun) -> None:
    found = re.search(r"osc://127\.0\.0\.1:(\d+)/tactable/", running.said)
    assert found is not None, running.said
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as program:
        program.connect(("127.0.0.1", int(found[1])))
        program.send(encode_osc("/tactable/ping", []))
        assert decode_osc(program.recv(1 << 16)) == [("/tactable/answer", ["/tactable/ping", True, ""])]


def programs_meet_the_device_of_a_new_table(running: ControlledRun) -> None:
    with connected(running) as client:
        client.set_region("kept", ["100 mm", "140 mm"], touch="press", stays=True)
    longer = DEVICE.with_values({"bar.length": "350 mm"})
    folder = running.socket.parent
    write_table(folder / "new.nc", longer, response=0.05)
    (folder / "new.nc").replace(folder / "bar.nc")
    wait_until(lambda: greeting(running)["length_m"] == longer.bar.length_m)
    with connected(running) as client:
        assert [zone["stop_m"] for zone in client.run["zones"]] == [zone.stop_m for zone in longer.zones]
        assert client.run["regions"] == ["kept"]  # it keeps its metres
        at_m = pytest.approx(0.2 * longer.bar.length_m, abs=1e-4)
        (finger,) = client.subscribe("touches", "played")
        if finger["at_m"] != at_m:  # the run is a moment later
            (finger,) = event_of(client, "touches", lambda event: bool(event["fingers"][0]["at_m"] == at_m))["fingers"]
        assert finger["zone"] == longer.zones[1].name and finger["region"] is None
        client.set_region("key", ["15 %", "25 %"], hold={"effect": "buzz", "after": "10 ms"})
        event = event_of(client, "played")
        assert event["kind"] == "drive" and event["promise"] is not None
        assert client.subscribe("played")[0]["region"] == "key"
        client.remove_region("key")
        assert event_of(client, "played")["kind"] == "silence"
