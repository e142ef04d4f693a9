"""A page that looks on at `tactable run`: another process, which the run neither waits for nor needs."""

import asyncio
import json
import os
import re
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest
from websockets.asyncio.client import connect
from websockets.typing import Origin

from engine.touch.sources.recording import write_recording
from firmware_link.emulator.emulator_process import RunningEmulator
from tactable.page.page_messages import Kind
from tests.tactable.cli.in_process import run_here
from tests.tactable.page.browser import decode_picture
from tests.tactable.rig.strokes import Stroke, make_recording
from tests.tools.processes import started

pytestmark = pytest.mark.machine(stall_s=None)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, click_table: Path) -> Path:
    """A table, and touches that take as long as a test may need: a tap in I and one in III every second."""
    folder = tmp_path_factory.mktemp("live")
    (folder / "bar.nc").write_bytes(click_table.read_bytes())
    strokes = [Stroke(t + 0.5 * k, t + 0.5 * k + 0.3, x, x) for t in range(200) for k, x in ((0, 1 / 6), (1, 5 / 6))]
    write_recording(make_recording(strokes), folder / "taps.hid")
    return folder


def run_of(folder: Path, emulator: RunningEmulator, *words: str) -> "subprocess.Popen[str]":
    paths = ("bar.nc", "--touch", "taps.hid", "--port", emulator.port)
    return started(folder, "run", *paths, "--reconnect", "--no-watch", "--no-solve", *words)


def address_of(process: "subprocess.Popen[str]") -> str:
    """What the run says of its page."""
    assert process.stderr is not None
    while not (found := re.search(r"http://\S+", line := process.stderr.readline())):
        assert line, process.poll()
    return found[0]


async def looked_on(address: str, commands: int) -> tuple[dict[str, Any], list[bytes]]:
    """The scene, and everything that comes until so many commands and a motion were seen."""
    origin = Origin(address[: address.index("/", 7)])
    scene, told, kinds = dict[str, Any](), list[bytes](), set[int]()
    async with connect(address.replace("http:", "ws:") + "socket", origin=origin) as socket:
        while True:
            message = await socket.recv()
            assert isinstance(message, bytes)
            kinds.add(message[1])
            if message[1] == Kind.SCENE:
                scene = json.loads(message[2:])
            told.append(message)
            is_picture = message[1] == Kind.PICTURE
            if is_picture and Kind.MOTION in kinds and decode_picture(message)[0]["command"] >= commands:
                return scene, told


def page_of(process: "subprocess.Popen[str]") -> int:
    """The process of the page."""
    children = ["ps", "-ww", "--ppid", str(process.pid), "-o", "pid=,args="]
    told = subprocess.run(children, capture_output=True, text=True, check=True).stdout
    (page,) = [int(line.split()[0]) for line in told.splitlines() if "tactable.page.processes.live_process" in line]
    return page


def test_a_run_is_shown_to_a_page_that_looks_on_and_outlives_it(folder: Path, emulator: RunningEmulator) -> None:
    words = ["bar.nc", "--touch", "taps.hid", "--port", emulator.port, "--no-watch", "--no-solve"]
    refused = run_here(folder, "run", *words, "--page", "--page-at", "192.0.2.1")  # before it begins
    assert refused.returncode == 1 and refused.stderr.splitlines()[-1].startswith("tactable: no page at 192.0.2.1")
    with run_of(folder, emulator, "--page", "--json") as process:
        address = address_of(process)
        scene, told = asyncio.run(looked_on(address, 3))
        os.kill(page_of(process), signal.SIGKILL)
        played = len(emulator.log().events)
        while len(emulator.log().events) < played + 4:
            assert process.poll() is None
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        summary, said = process.communicate()
    assert process.returncode == 0, said
    assert json.loads(summary)["commands_sent"] >= 6
    assert scene["mode"] == "live"
    assert [zone["name"] for zone in scene["device"]["zones"]] == ["I", "II", "III"]
    assert {message[1] for message in told} == {Kind.SCENE, Kind.PICTURE, Kind.MOTION}
