"""Laws of the control server: every message gets one answer, parts go one by one, and slow readers lose only events."""

import asyncio
import json
import random
from typing import Any

import pytest

from engine.effects.rules import SceneSettings
from tactable.control.control_server import MOST_UNREAD_BYTES, ControlServer
from tactable.shipped import find_device
from tests.tactable.control.messages import HELLO, ROOT, SAID, VALID, hostile_line
from tests.tactable.control.virtual import FINGERS, Program, VirtualSlot, on_virtual_time, server_of, settle

TRIGGER = {"type": "trigger", "effect": "buzz", "finger": 3}


class Line(Program):
    """The way back to a program, which checks what it gets against the schema."""

    def send(self, line: bytes) -> None:
        super().send(line)
        SAID.validate(self.said[-1])


async def what_is_said(server: ControlServer, *messages: dict[str, Any] | bytes) -> list[dict[str, Any]]:
    """To a program that sends these and hangs up."""
    program = Line()
    for message in messages:
        program.tell(message)
    program.hang_up()
    await server.converse(program.lines(), program)
    return program.said


@on_virtual_time
async def test_each_message_has_its_answer_in_order(server: ControlServer, slot: VirtualSlot) -> None:
    numbered = [message | {"id": number} for number, message in enumerate(VALID)]
    said = await what_is_said(server, *numbered)
    assert [each["answer"] for each in said] == [*range(len(VALID))]
    assert all(each["ok"] for each in said), said
    assert slot.steps[-1].gone_owner == 1 and list(server.scene.regions) == ["scale"]  # which stays


@on_virtual_time
async def test_a_program_begins_with_a_hello_and_has_no_step_unasked(server: ControlServer, slot: VirtualSlot) -> None:
    said = await what_is_said(server, {"type": "stop"}, HELLO, {"type": "ping"})
    assert [each["ok"] for each in said] == [False, True, True]
    assert '{"type": "hello", "version": 1' in said[0]["error"]
    assert slot.steps == []


@on_virtual_time
async def test_a_program_that_has_hung_up_is_told_nothing_more(server: ControlServer) -> None:
    said = await what_is_said(server, HELLO)
    await asyncio.sleep(10.0)
    assert len(said) == 1


@on_virtual_time
async def test_hostile_messages_get_nothing_but_answers(server: ControlServer, slot: VirtualSlot) -> None:
    random_ = random.Random(3)
    lines = [hostile_line(random_) for _ in range(1000)]
    said = await what_is_said(server, HELLO, *lines)
    assert len(said) == 1001
    assert all("answer" in each for each in said)
    assert len(slot.steps) > 33


@on_virtual_time
async def test_one_program_too_many_is_told_so(server: ControlServer) -> None:
    held = [Line().begin(server) for _ in range(16)]  # as docs/programs.md says
    await settle()
    said = await what_is_said(server, HELLO)
    assert [each["ok"] for each in said] == [False] and "end one of them" in said[0]["error"]
    for program in held:
        program.hang_up()
    await settle()


@on_virtual_time
async def test_a_connection_that_never_greets_is_closed_and_one_that_greeted_is_not(server: ControlServer) -> None:
    silent, babbling, greeting = Line(), Line(), Line().begin(server)
    babbling.tell({"type": "ping"})
    for program in (silent, babbling):
        await server.converse(program.lines(), program)
    assert [each["error"] for each in silent.said] == ["run: no hello within 10 s: the connection is closed"]
    assert len(babbling.said) == 2 and "no hello" in babbling.said[1]["error"]
    assert len(server._programs) == 1 and greeting.talk is not None and not greeting.talk.done()
    greeting.hang_up()
    await settle()


@on_virtual_time
async def test_an_effect_file_is_defined_with_a_report_and_ends_with_the_program(server: ControlServer) -> None:
    content = json.loads((ROOT / "tables" / "effects" / "knock.ahap").read_text(encoding="utf-8"))
    define = {"type": "define", "name": "knock", "format": "ahap", "content": content}
    said = await what_is_said(server, HELLO, define, {"type": "trigger", "effect": "knock", "finger": 3})
    assert [each["fate"] for each in said[1]["events"]] == ["kept", "kept", "kept"]
    assert said[2]["ok"] and "knock" not in server.scene.effects


@on_virtual_time
async def test_after_a_change_of_table_positions_are_the_new_devices(server: ControlServer, slot: VirtualSlot) -> None:
    server.adopt(find_device("reference-t"))
    said = await what_is_said(server, HELLO, VALID[1])
    device = find_device("reference-t")
    assert said[0]["device"] == "reference-t"
    assert [zone["stop_m"] for zone in said[0]["zones"]] == [zone.stop_m for zone in device.zones]
    rules = slot.steps[0].rules
    assert rules is not None and rules[0].region_m == pytest.approx((0.01, 0.3 * device.bar.length_m))


@on_virtual_time
async def test_a_finger_that_is_not_there_is_named_with_those_that_are_and_one_that_is_quiet_refuses_triggers(
    server: ControlServer,
) -> None:
    away, quiet = TRIGGER | {"finger": 9}, {"type": "role", "finger": 3, "role": "quiet"}
    said = await what_is_said(server, HELLO, away, quiet | {"finger": 9}, quiet, TRIGGER)
    for answer, key in zip(said[1:3], ("trigger", "role"), strict=True):
        assert answer["error"] == f"{key}.finger: 9: does not touch the bar; of these that do: 3"
    assert said[3]["ok"] and "'by rules'" in said[4]["error"]


@pytest.mark.parametrize("reads", [True, False])
@on_virtual_time
async def test_a_program_that_reads_too_slowly_loses_events_and_is_told_how_many(
    server: ControlServer, reads: bool
) -> None:
    line = Program(reads=reads).begin(server)
    await line.ask({"type": "subscribe", "to": ["touches"]})
    assert server.wanted_streams == {"touches"}
    event = {"event": "touches", "time_ns": 1, "fingers": FINGERS * 50}
    server.publish([event] * 200)
    got = len(line.said) - 2
    assert got == 200 if reads else got < 200 and line.unread_bytes() < 2 * MOST_UNREAD_BYTES
    line.read_all()
    server.publish([event])
    server.publish([event])
    told = [each["count"] for each in line.said if each.get("event") == "lost"]
    assert told == ([] if reads else [200 - got])  # once
    line.hang_up()
    await settle()


@on_virtual_time
async def test_what_a_lease_holds_ends_after_its_silence_not_before(server: ControlServer, slot: VirtualSlot) -> None:
    for lease, lease_s in (("0.1 s", 0.1), ("3600 s", 3600.0), (None, 5.0)):
        program = Line().begin(server, **({} if lease is None else {"lease": lease}))
        await program.ask(VALID[1], VALID[4], VALID[6], TRIGGER, {"type": "role", "finger": 3, "role": "quiet"})
        for _ in range(2):  # whatever is sent renews it
            await asyncio.sleep(0.99 * lease_s)
            await program.ask({"type": "ping"})
        await asyncio.sleep(0.99 * lease_s)
        assert list(server.scene.regions) == ["ok"] and "mine" in server.scene.effects
        assert slot.player.fingers[3].is_kept_quiet and {"event": "lease ended"} not in program.said
        await asyncio.sleep(0.02 * lease_s)
        await settle()
        assert program.said[-1] == {"event": "lease ended"} and not slot.player.fingers[3].is_kept_quiet
        assert not server.scene.regions and "mine" not in server.scene.effects
        assert slot.player.scene.settings == SceneSettings() and slot.player.wanted.level_db is None
        program.hang_up()
        await settle()


@on_virtual_time
async def test_a_program_that_is_broken_off_in_a_step_leaves_the_loop_with_the_whole_of_it() -> None:
    slot = VirtualSlot()
    server = server_of(slot)
    program = Line().begin(server)
    await program.ask(VALID[1])
    assert program.talk is not None
    program.talk.cancel()
    await settle()
    while slot.poll():
        await settle()
    assert slot.steps[0].rules and slot.steps[-1].gone_owner == 1 and slot.decoder.scene.rules == ()


@pytest.mark.parametrize("message", [TRIGGER, {"type": "trigger", "effect": "error", "at": "120 mm"}])
@on_virtual_time
async def test_while_a_program_has_switched_feeling_off_triggers_are_refused_and_nothing_sounds(
    server: ControlServer, slot: VirtualSlot, message: dict[str, Any]
) -> None:
    first, second = Line().begin(server), Line().begin(server)
    await first.ask(message)
    assert slot.player.wanted.level_db is not None
    await second.ask({"type": "settings", "enabled": False})
    assert slot.player.wanted.level_db is None
    assert "switched feeling off" in (await first.ask(message))["error"] and slot.player.wanted.level_db is None
    second.hang_up()
    await settle()
    assert (await first.ask(message))["ok"] and slot.player.wanted.level_db is not None
