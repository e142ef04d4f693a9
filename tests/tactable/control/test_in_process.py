"""The control process and its slot in one process, on virtual time: programs at the socket, the test is the loop."""

import asyncio
import json
import os
import re
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import tactable
from engine.device import Device
from engine.effects.effect_player import EffectPlayer
from engine.effects.rules import ControlStep, Outcome, Role, SceneSettings, TriggeredEffect
from engine.loop.observer import CommandRecord, Fate, LoopCounters, Stage
from engine.loop.ring import RingReader, RingWriter
from engine.table import Table
from engine.touch import Touch
from firmware_link.host.link_values import Capabilities
from tactable.control.client import AsyncClient, ClientError, connect_async
from tactable.control.control_process import serve
from tactable.control.osc import decode_osc, encode_osc
from tactable.control.requests import Scene
from tactable.control.slot import ControlOf, ControlProcess
from tactable.control.steps import StepEncoder
from tactable.shipped import named_effects
from tests.engine.made_table import write_table
from tests.tactable.control.messages import HELLO
from tests.tactable.control.virtual import BASE, DEVICE, FINGER, on_virtual_time, settle
from tests.tools.child_here import ChildHere, ParentHere

pytestmark = pytest.mark.usefixtures("both_ends")
LONGER = DEVICE.with_values({"bar.length": "350 mm"})
FULL_SCALES_M = tuple(each.full_scale_m for each in DEVICE.actuators)
CAPABILITIES = Capabilities(2, 0.01, 10.0, 1000.0, FULL_SCALES_M, 80, 48_000, 1, 0)
BUZZ = {"type": "trigger", "effect": "buzz", "finger": 3}
REGION = {"type": "region", "name": "a", "region": ["0 mm", "90 mm"], "rules": [{"on": "touch", "effect": "press"}]}


@dataclass
class Run:
    """A run whose loop is polled every millisecond of virtual time."""

    slot: ControlProcess
    served: ControlOf
    ring: RingWriter
    player: EffectPlayer

    async def connect(self, lease_s: float | None = None) -> AsyncClient:
        return await connect_async(self.served.socket, name="a test", lease_s=lease_s)

    async def loop(self) -> None:
        while True:
            step = self.slot.poll()
            if step is not None:
                self.slot.tell_outcome(self.player.control(step, 0))
            await asyncio.sleep(0.001)

    def change_run(self, table: Path) -> None:
        self.slot.change_run(table)
        self.player = player_of(self.slot)

    def touch(self, *touches: Touch) -> None:
        """A frame of the loop, in the ring."""
        stamps = (0,) * len(Stage)
        frame = (None, None, False, touches, b"", Fate.NONE, None)
        self.ring.observe(CommandRecord(stamps, 1, b"", None, *frame), LoopCounters())  # type: ignore[arg-type]


def player_of(slot: ControlProcess) -> EffectPlayer:
    player = EffectPlayer(BASE)
    player.control(slot.scene(), 0)
    player.take_touches([FINGER], 0)
    return player


def slot_alone(folder: Path) -> tuple[ControlProcess, ChildHere, socket.socket]:
    """A slot, its child, and the test's end of what they say to each other."""
    ours, theirs = socket.socketpair()
    theirs.sendall(b'{"lines": []}\n')
    child = ChildHere(ours)
    return ControlProcess(ControlOf(folder, folder, folder), lambda *_, **__: child), child, theirs


def write(path: Path, device: Device = DEVICE) -> Path:
    write_table(path, device, response=0.05)
    return path


@asynccontextmanager
async def started(folder: Path, **more: Any) -> AsyncIterator[Run]:
    """A run that has connected to its device, until the end of the block."""
    served = ControlOf(folder / "c.sock", folder / "ring", write(folder / "bar.nc"), **more)
    ours, theirs = socket.socketpair()
    with RingWriter(served.ring, 64) as ring, RingReader(served.ring) as reader, theirs:
        table = Table.open(served.table, verify=False)
        serving = asyncio.ensure_future(serve(served, table, reader, ParentHere(theirs)))
        child = ChildHere(ours)
        while not child.has_spoken():
            await asyncio.sleep(0)
        slot = ControlProcess(served, lambda *_, **__: child)
        run = Run(slot, served, ring, player_of(slot))
        slot.begin_steps(CAPABILITIES)
        looping = asyncio.ensure_future(run.loop())
        try:
            yield run
        finally:
            looping.cancel()
            slot.__exit__(None, None, None)
            await serving
            table.close()
            assert not served.socket.exists()


@on_virtual_time
async def test_a_program_triggers_hears_who_touches_and_ends_with_its_connection_or_the_run(tmp_path: Path) -> None:
    """What waits for the loop when the run ends is refused."""
    async with started(tmp_path) as run:
        assert run.slot.lines == [f"control: {run.served.socket}"]
        client = await run.connect()
        assert (client.run["device"], client.run["lease_s"]) == ("reference-a", 5.0)
        await client.ask(BUZZ)
        assert run.player.wanted.level_db == 20.0
        await client.ask({"type": "subscribe", "to": ["touches"]})
        await client.ask(REGION)
        run.touch(FINGER)
        (finger,) = (await anext(client.events()))["fingers"]
        assert (finger["finger"], finger["at_m"], finger["zone"], finger["region"]) == (3, 0.05, "I", "a")
        await client.close()
        await asyncio.sleep(0.1)
        assert run.player.wanted.level_db is None and run.slot.scene().rules == ()
        client = await run.connect()
        waits = asyncio.ensure_future(client.ask(BUZZ))
        await settle()
    for asked in (waits, client.ask({"type": "ping"})):
        with pytest.raises(ClientError):
            await asked
    await client.close()


@on_virtual_time
async def test_a_finger_that_lifts_between_two_runs_touches_in_neither(tmp_path: Path) -> None:
    async with started(tmp_path) as run:
        client = await run.connect()
        await client.ask({"type": "subscribe", "to": ["touches"]})
        run.touch(FINGER)
        assert len((await anext(client.events()))["fingers"]) == 1
        run.change_run(run.served.table)
        run.ring.begin_run(0)
        assert (await anext(client.events()))["fingers"] == []
        await client.close()


def test_without_a_run_there_is_an_error_with_a_remedy(tmp_path: Path) -> None:
    with pytest.raises(ClientError, match=r"nobody.sock: no run listens there .*tactable run ... --control"):
        tactable.connect(tmp_path / "nobody.sock")


@on_virtual_time
async def test_programs_scene_holds_in_another_run_and_their_regions_unless_zones_differ(tmp_path: Path) -> None:
    async with started(tmp_path) as run:
        client = await run.connect(60.0)
        await client.ask(REGION)
        await client.ask({"type": "settings", "level_change": "-5 dB"})
        run.change_run(write(tmp_path / "longer.nc", LONGER))
        assert (
            run.player.scene.effects.rules[0].region_m == (0.0, 0.09) and run.player.wanted.level_db == 20.0
        )  # press, 5 dB less
        await until(run, lambda run_: run_["length_m"] == LONGER.bar.length_m)
        assert run.player.scene.effects.rules[0].region_m == (0.0, 0.09)
        run.change_run(write(tmp_path / "other.nc", DEVICE.with_values({"zones.count": 3})))
        await until(run, lambda run_: not run_["regions"])
        await asyncio.sleep(0.1)
        assert run.player.scene.effects.rules == BASE.rules and run.player.scene.settings == SceneSettings(
            level_change_db=-5.0
        )
        run.change_run(tmp_path / "missing.nc")  # replaced already: the next one is announced
        await until(run, lambda run_: len(run_["zones"]) == 3)
        await client.close()


async def until(run: Run, holds: Callable[[dict[str, Any]], bool]) -> None:
    """Greet again until the greeting says so, for half a minute of virtual time."""
    for _ in range(600):
        client = await run.connect()
        await client.close()
        if holds(client.run):
            return
        await asyncio.sleep(0.05)
    raise AssertionError(f"it never held of {client.run}")


@pytest.mark.parametrize("is_watched", [True, False])
@on_virtual_time
async def test_another_table_at_the_path_is_programs_where_the_run_takes_it(tmp_path: Path, is_watched: bool) -> None:
    async with started(tmp_path, is_watched=is_watched) as run:
        for device in (DEVICE.with_values({"zones.count": 3}), LONGER):  # the run refuses the first one
            write(tmp_path / "new.nc", device).replace(run.served.table)
            if is_watched and device is LONGER:
                await until(run, lambda run_: run_["length_m"] == LONGER.bar.length_m)
            await asyncio.sleep(5.0)
            await settle()
            client = await run.connect()
            is_adopted = is_watched and device is LONGER
            assert client.run["length_m"] == (LONGER if is_adopted else DEVICE).bar.length_m
            assert len(client.run["zones"]) == len(DEVICE.zones)
            await client.close()


def test_when_the_control_process_ends_the_run_goes_on_without_what_programs_held(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    slot, child, theirs = slot_alone(tmp_path)
    scene, encoder = Scene(named_effects()), StepEncoder()
    scene.set_settings(7, SceneSettings(True, False, -6.0))
    trigger = TriggeredEffect(scene.effects["buzz"], 7, 3, None)
    player = player_of(slot)
    player.take_touches([FINGER, Touch(4, 0.2, 3)], 0)
    player.advance_effects(10**9)
    for part in encoder.parts(scene, ControlStep(role=Role(4, True, 8), trigger=trigger)):
        theirs.sendall(len(part).to_bytes(8, "little") + part)
        for _ in range(2):  # the size, then the part
            step = slot.poll()
            if step is not None:
                slot.tell_outcome(player.control(step, 2 * 10**9))
        assert theirs.recv(1 << 16).count(b"\n") == 1
    assert player.wanted.level_db == 14.0 and player.fingers[4].is_kept_quiet
    theirs.close()
    step = slot.poll()
    assert step is not None and player.control(step, 0) is Outcome.DONE
    assert (
        player.wanted.level_db is None
        and not player.fingers[4].is_kept_quiet
        and player.scene.settings == SceneSettings()
    )
    slot.tell_outcome(Outcome.DONE)
    assert slot.poll() is None and "no longer heard" in capfd.readouterr().err
    waits = list[bool]()
    monkeypatch.setattr(child, "end", lambda: waits.append(os.get_blocking(child._socket.fileno())))
    slot.__exit__(None, None, None)
    assert waits == [True], "the end of the process is waited for"
    child._socket.close()


@pytest.mark.parametrize("said", [b"\x02" + bytes(7) + b"{}", b"Traceback", (8193).to_bytes(8, "little")])
def test_a_control_process_that_says_what_is_no_part_is_not_heard_again(tmp_path: Path, said: bytes) -> None:
    slot, _, theirs = slot_alone(tmp_path)
    theirs.sendall(said)
    steps = [slot.poll() for _ in range(3)]
    assert [step.are_all_gone for step in steps if step is not None] == [True]
    theirs.close()
    slot.__exit__(None, None, None)


@on_virtual_time
async def test_what_is_no_message_gets_an_answer_and_the_next_one_is_heard(tmp_path: Path) -> None:
    async with started(tmp_path) as run:
        reader, writer = await asyncio.open_unix_connection(run.served.socket)
        writer.write(b'{"type": "ping"}\n' + b"x" * 100_000 + b"\n" + json.dumps(HELLO | {"id": 3}).encode() + b"\n")
        writer.write(b"[1]\n\xff\n\n" + b'{"id": 4, "type": "ping"}\n')
        answers = [json.loads(await reader.readline()) for _ in range(7)]
        assert [each["answer"] for each in answers] == [None, None, 3, None, None, None, 4]
        assert [each["ok"] for each in answers] == [False, False, True, False, False, False, True]
        writer.close()


@on_virtual_time
async def test_open_sound_control_is_served_where_it_says(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    async with started(tmp_path, osc_port=0) as run:
        found = re.search(r"osc://127\.0\.0\.1:(\d+)/tactable/", " ".join(run.slot.lines))
        assert found is not None
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as program:
            program.setblocking(False)
            program.connect(("127.0.0.1", int(found[1])))
            program.send(encode_osc("/tactable/trigger", ["buzz", 3]))
            answer = await asyncio.get_running_loop().sock_recv(program, 1 << 16)
        assert decode_osc(answer) == [("/tactable/answer", ["/tactable/trigger", True, ""])]
        assert run.player.wanted.level_db == 20.0
    assert "OSC: 1 messages, 0 refused" in capfd.readouterr().err  # told at the end
