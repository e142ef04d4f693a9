"""A page that looks on at `tactable run`: another process, which the run neither waits for nor needs."""

import asyncio
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import Any

import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.typing import Origin

from engine.loop import RingReader, RingWriter
from engine.table import Table
from engine.touch import Placement
from engine.touch.sources.recording import write_recording
from firmware_link.emulator.process import RunningEmulator, run_emulator
from tactable.page.hand import Channels
from tactable.page.live_backend import LiveBackend
from tactable.page.messages import Drive, Kind, encode_choice
from tests.engine.loop.observed import observe
from tests.tactable.page.played import LEVEL_DB, RESOLUTION_HZ, record_of
from tests.tactable.rig.strokes import Stroke, make_recording

pytestmark = pytest.mark.machine

TACTABLE = str(Path(sys.executable).parent / "tactable")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, click_table: Path) -> Path:
    """A table, and touches that take as long as a test may need: a tap in I and one in III every second."""
    folder = tmp_path_factory.mktemp("live")
    (folder / "bar.nc").write_bytes(click_table.read_bytes())
    strokes = [Stroke(t + 0.5 * k, t + 0.5 * k + 0.3, x, x) for t in range(200) for k, x in ((0, 1 / 6), (1, 5 / 6))]
    write_recording(make_recording(strokes), folder / "taps.hid")
    return folder


@pytest.fixture
def emulator() -> Iterator[RunningEmulator]:
    with run_emulator() as running:
        yield running


@contextmanager
def started(folder: Path, emulator: RunningEmulator, *words: str) -> Iterator["subprocess.Popen[str]"]:
    paths = ("bar.nc", "--touch", "taps.hid", "--port", emulator.port)
    command = [TACTABLE, "run", *paths, "--reconnect", "--no-watch", "--no-solve", *words]
    with subprocess.Popen(command, cwd=folder, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        yield process


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
            if (
                Kind.MOTION in kinds
                and int.from_bytes(told[-1][34:38], "little") >= commands
                and told[-1][1] == Kind.PICTURE
            ):
                return scene, told


def page_of(process: "subprocess.Popen[str]") -> int:
    """The process of the page."""
    children = ["ps", "-ww", "--ppid", str(process.pid), "-o", "pid=,args="]
    told = subprocess.run(children, capture_output=True, text=True, check=True).stdout
    (page,) = [int(line.split()[0]) for line in told.splitlines() if "tactable.page.processes.live" in line]
    return page


def test_a_run_is_shown_to_a_page_that_only_looks_on_and_goes_on_when_that_is_killed(
    folder: Path, emulator: RunningEmulator
) -> None:
    async def ask(address: str) -> None:
        async with hand_at(address) as hand:
            await hand.until(lambda: bool(hand.scene))
            before = hand.commands
            await hand.say(source="hand")
            await hand.until(lambda: hand.commands >= before + 3)
            assert (hand.scene["drives"], hand.scene["choice"], hand.is_driving) == (False, {}, False)

    with started(folder, emulator, "--page", "--json") as process:
        address = address_of(process)
        scene, told = asyncio.run(looked_on(address, 3))
        asyncio.run(ask(address))
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


def test_a_page_that_finds_no_place_is_refused_before_the_run_begins(folder: Path, emulator: RunningEmulator) -> None:
    with started(folder, emulator, "--page", "--page-host", "192.0.2.1") as process:
        _, said = process.communicate()
    assert process.returncode == 1
    assert said.splitlines()[-1].startswith("tactable: no page at 192.0.2.1")


IS_PLAYING = 2
"""A flag of a picture."""
HAND = [[150.0, 0.2, 0.0], [120.0, 0.1, 90.0]]
REPEAT_S = 0.2


class Hand:
    """A browser that asks a board for a drive, and repeats it while it waits."""

    def __init__(self, socket: ClientConnection) -> None:
        self.scene = dict[str, Any]()
        self.commands = self.drive = 0
        self._socket = socket

    async def until(self, condition: Callable[[], bool], repeats: object = None) -> None:
        said_s = 0.0
        while not condition():
            if repeats is not None and (now_s := time.monotonic()) - said_s > REPEAT_S:
                said_s = now_s
                await self._socket.send(encode_choice({"hand": repeats}))
            message = await self._socket.recv()
            assert isinstance(message, bytes)
            if message[1] == Kind.SCENE:
                self.scene = json.loads(message[2:])
            elif message[1] == Kind.PICTURE:
                self.commands, self.drive = int.from_bytes(message[34:38], "little"), message[90]

    async def say(self, **switches: object) -> None:
        await self._socket.send(encode_choice(switches))

    @property
    def is_driving(self) -> bool:
        return bool(self.scene.get("plays") == {"source": "hand"})


def test_how_the_run_of_the_touches_ended_is_no_end_of_a_drive_by_hand(folder: Path, tmp_path: Path) -> None:
    """The page may hear of the drive before it has read the last records of the run."""
    at_ns, asked = time.monotonic_ns(), list[Channels | None]()
    with (
        Table.open(folder / "bar.nc") as table,
        RingWriter(tmp_path / "ring") as ring,
        RingReader(ring.path) as reader,
    ):
        scales_m = [actuator.full_scale_m for actuator in table.device.actuators]
        backend = LiveBackend(reader, folder / "bar.nc", RESOLUTION_HZ, scales_m, asked.append)
        for level_db in (LEVEL_DB, None):
            observe(ring, record_of(table, Placement((0.035,), (True,)), at_ns, level_db=level_db))
        backend.choose({"source": "hand"})
        backend.hear(is_driving=True)
        messages, _ = backend.tick()
    assert asked == [((150.0, 0.0, 0.0),) * 2]
    drive, flags = messages[-1][90:92]
    assert (drive, bool(flags & IS_PLAYING)) == (Drive.STEADY, True)


@asynccontextmanager
async def hand_at(address: str) -> AsyncIterator[Hand]:
    origin = Origin(address[: address.index("/", 7)])
    async with connect(address.replace("http:", "ws:") + "socket", origin=origin) as socket:
        yield Hand(socket)


def driven(emulator: RunningEmulator) -> list[tuple[float, float]]:
    """Frequency and amplitude of every actuator, as the board was last told."""
    return [(channel.frequency_hz, channel.amplitude) for channel in emulator.log().events[-1].channels]


def is_by_hand(emulator: RunningEmulator) -> bool:
    return all(
        abs(hz - asked_hz) < 0.01 and abs(amplitude - asked) < 1e-3
        for (hz, amplitude), (asked_hz, asked, _) in zip(driven(emulator), HAND, strict=True)
    )


def test_a_board_is_driven_by_hand_until_it_is_given_back_or_the_page_is_silent(
    folder: Path, emulator: RunningEmulator
) -> None:
    """Silent at first, refused beyond a limit; the board answers touches again afterwards."""

    async def drive(address: str) -> None:
        async with hand_at(address) as hand:
            await hand.until(lambda: hand.commands >= 2)
            await hand.say(source="hand")
            await hand.until(lambda: hand.is_driving)
            assert hand.scene["choice"]["hand"] == [[150.0, 0.0, 0.0]] * 2
            assert not any(amplitude for _, amplitude in driven(emulator))
            await hand.until(lambda: hand.scene["choice"].get("hand") == HAND, HAND)
            await hand.until(lambda: is_by_hand(emulator), HAND)
            await hand.say(hand=[[150.0, 2.0, 0.0], HAND[1]])
            await hand.until(lambda: "200 %" in hand.scene["trouble"], HAND)
            assert is_by_hand(emulator)
            await hand.say(source="click")
            await hand.until(lambda: not hand.is_driving)
            before = hand.commands
            await hand.until(lambda: hand.commands >= before + 2 and hand.drive == Drive.CLICK)
            await hand.say(source="hand")
            await hand.until(lambda: hand.is_driving)
            await hand.until(lambda: hand.scene["choice"].get("hand") == HAND, HAND)
            await hand.until(lambda: not hand.is_driving)  # it repeats nothing
            before = hand.commands
            await hand.until(lambda: hand.commands >= before + 2)

    with started(folder, emulator, "--page", "--page-drive", "--json") as process:
        asyncio.run(drive(address_of(process)))
        process.send_signal(signal.SIGINT)
        summary, said = process.communicate()
    assert process.returncode == 0, said
    assert json.loads(summary)["commands_sent"] >= 6
