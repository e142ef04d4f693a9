"""Laws of messages and of the control server: what is wrong is named, and every message gets one answer."""

import asyncio
import json
import random
from typing import Any

import jsonschema
import pytest

from engine.effects.rules import SceneSettings
from tactable.control.control_server import MOST_UNREAD_BYTES, ControlServer
from tactable.control.requests import MOST_BYTES, ControlError, Request, decode_line, read_request
from tactable.shipped import find_device, named_effects
from tests.tactable.control.messages import HELLO, MESSAGE, ROOT, SAID, SCHEMA, VALID, edited, hostile_line
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


DEVICE, EFFECTS = find_device("reference-a"), named_effects()


def read(message: dict[str, object]) -> Request:
    return read_request({key: value for key, value in message.items() if key != "id"}, DEVICE, EFFECTS, 1)


@pytest.mark.parametrize("message", VALID, ids=lambda message: message["type"])
def test_a_valid_message_is_read_and_fits_the_schema(message: dict[str, object]) -> None:
    read(message)
    MESSAGE.validate(message)
    assert decode_line(json.dumps(message).encode())[0] == message.get("id")


def test_the_schema_has_every_message_and_each_of_its_keys_is_read() -> None:
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    kinds = {key.removeprefix("message_"): part for key, part in SCHEMA["$defs"].items() if key.startswith("message_")}
    assert set(kinds) == {message["type"] for message in VALID}
    for kind, part in kinds.items():
        seen = {key for message in VALID if message["type"] == kind for key in message}
        assert seen | {"id"} == set(part["properties"]), kind


def test_what_the_schema_refuses_the_reader_refuses() -> None:
    random_, read_ones, refused = random.Random(11), 0, 0
    for _ in range(2000):
        message = edited(random_)
        try:
            number, values = decode_line(json.dumps(message).encode())
            read_request(values, DEVICE, EFFECTS, 1)
        except ControlError as error:
            refused += 1
            assert len(str(error)) < 1200
            continue
        read_ones += 1
        # A key with null for an id counts as no id.
        MESSAGE.validate({key: value for key, value in message.items() if key != "id" or number is not None})
    assert read_ones > 333 and refused > 333


# (a valid message of this kind with other keys, what the refusal says)
WRONG = [
    ({"type": "tap"}, "message: type: 'tap': expected one of hello, region"),
    (HELLO | {"version": 2}, "hello.version: 2: this run speaks version 1"),
    (HELLO | {"lease": "0.01 s"}, "hello.lease: '0.01 s': expected at least 0.1 s"),
    (HELLO | {"lease": "7200 s"}, "hello.lease: '7200 s': expected at most 3600 s"),
    (VALID[1] | {"region": ["10 kg", "20 mm"]}, "region.region: '10 kg' is a mass; expected a length"),
    (
        VALID[1] | {"rules": [{"on": "touch", "effect": "pres"}]},
        "region.rules[0].effect: 'pres': expected one of click",
    ),
    (VALID[1] | {"rules": [{"on": "touch", "effect": "press", "zones": ["I"]}]}, "leave 'zones' and 'region' out"),
    (VALID[1] | {"level_change": "louder"}, "region.level_change: 'louder': expected -80 to 80 dB"),
    ({"type": "region", "name": "ok", "rules": []}, "region.region: None: expected two positions"),
    ({"type": "define", "name": "x", "envelope": [["5 ms", "20 dB"]] * 17}, "define.envelope: 17: expected at most 16"),
    (VALID[5] | {"content": {"Pattern": [{"Event": {}}]}}, "define.content: Pattern[0].Event: {}: expected an object"),
    (VALID[5] | {"envelope": [["click", "20 dB"]]}, "define.envelope: [['click', '20 dB']]: unknown key"),
    (VALID[5] | {"content": {"Pattern": []}}, "filed: its file has no event that is felt"),
    ({"type": "trigger", "effect": "click", "finger": 1, "at": "1 mm"}, "give either a finger or 'at'"),
    ({"type": "trigger", "effect": "buzz", "at": "1 mm"}, "trigger.effect: 'buzz': is held, but at a place no finger"),
    ({"type": "trigger", "effect": "click", "at": "1 m"}, "trigger.at: '1 m': is off the bar, which is 279.4 mm long"),
    ({"type": "subscribe", "to": ["all"]}, "subscribe.to: ['all']: expected a list of touches, played"),
]


@pytest.mark.parametrize(("message", "expected"), WRONG, ids=[expected for _, expected in WRONG])
def test_what_is_wrong_is_refused_by_key_value_and_expectation(message: dict[str, object], expected: str) -> None:
    with pytest.raises(ControlError) as refused:
        read(message)
    assert expected in str(refused.value)


LONGEST = b'{"x": "' + b"x" * (MOST_BYTES - 9) + b'"}'
NO_MESSAGES = [b"", b"{", b"[]", b"NaN", b'{"type": Infinity}', b"\xff", b"[" * 9000, b'{"id": -1}', LONGEST + b" "]


@pytest.mark.parametrize("line", [*NO_MESSAGES, b'{"id": 9007199254740992}'])
def test_what_is_no_message_is_refused_and_what_is_as_long_and_as_large_as_may_be_is_read(line: bytes) -> None:
    with pytest.raises(ControlError, match=r"expected|no number"):
        decode_line(line)
    assert decode_line(LONGEST)[1]["x"][0] == "x"
    assert decode_line(b'{"id": 9007199254740991}') == (9007199254740991, {})
