"""Laws of the control server: every message gets one answer, steps go one by one, and slow readers lose only events."""

import asyncio
import json
import random
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from engine.effects import ControlStep, Effects, Outcome
from tactable.control.scene import Scene
from tactable.control.server import MOST_PROGRAMS, MOST_UNREAD_BYTES, ControlServer
from tactable.shipped import find_device, named_effects
from tests.tactable.control.messages import HELLO, VALID, hostile_line
from tests.tactable.control.test_scene import BASE

ROOT = Path(__file__).parents[3]
SCHEMA = json.loads((ROOT / "tables" / "schemas" / "control.schema.json").read_text(encoding="utf-8"))
SAID = jsonschema.Draft202012Validator(
    {"oneOf": [{"$ref": "#/$defs/answer"}, {"$ref": "#/$defs/event"}], "$defs": SCHEMA["$defs"]}
)
FINGERS = [{"finger": 3, "at_m": 0.05, "zone": "I", "region": None}]


class Loop:
    """Takes steps as the loop does, one at a time; finger 3 touches."""

    def __init__(self) -> None:
        self.steps: list[ControlStep] = []
        self._is_busy = False

    async def take(self, step: ControlStep) -> Outcome:
        assert not self._is_busy
        self._is_busy = True
        await asyncio.sleep(0)
        self._is_busy = False
        self.steps.append(step)
        named = [contact_id for contact_id, _ in step.roles]
        if step.trigger is not None and step.trigger.contact_id is not None:
            named.append(step.trigger.contact_id)
        return Outcome.DONE if all(number == 3 for number in named) else Outcome.NO_FINGER


class Line:
    """The way back to a program that reads everything, or nothing."""

    def __init__(self, *, reads: bool = True) -> None:
        self.said: list[dict[str, Any]] = []
        self._reads, self._unread = reads, 0

    def send(self, line: bytes) -> None:
        self._unread += 0 if self._reads else len(line)
        self.said.append(json.loads(line))
        SAID.validate(self.said[-1])

    async def drain(self) -> None:
        await asyncio.sleep(0)

    def unread_bytes(self) -> int:
        return self._unread


def run(act: Callable[[ControlServer, Loop], Awaitable[None]]) -> None:
    async def started() -> None:
        loop = Loop()
        await act(
            ControlServer(Scene(BASE, named_effects()), find_device("reference-a"), loop.take, lambda: FINGERS), loop
        )

    asyncio.run(started())


async def lines_of(*messages: dict[str, Any] | bytes, forever: bool = False) -> AsyncIterator[bytes]:
    for message in messages:
        yield message if isinstance(message, bytes) else json.dumps(message).encode()
    while forever:
        await asyncio.sleep(0.01)


def test_each_message_has_its_answer_in_order() -> None:
    async def act(server: ControlServer, loop: Loop) -> None:
        line = Line()
        numbered = [message | {"id": number} for number, message in enumerate(VALID)]
        await server.converse(lines_of(*numbered), line)
        assert [each["answer"] for each in line.said] == [*range(len(VALID))]
        assert all(each["ok"] for each in line.said), line.said
        assert loop.steps[-1].effects == BASE or loop.steps[-1].effects is not None

    run(act)


def test_the_first_message_is_a_hello() -> None:
    async def act(server: ControlServer, loop: Loop) -> None:
        line = Line()
        await server.converse(lines_of({"type": "stop"}, HELLO, {"type": "stop"}), line)
        assert [each["ok"] for each in line.said] == [False, True, True]
        assert '{"type": "hello", "version": 1' in line.said[0]["error"]
        assert loop.steps == []

    run(act)


def test_hostile_messages_get_nothing_but_answers() -> None:
    async def act(server: ControlServer, loop: Loop) -> None:
        random_ = random.Random(3)
        lines = [hostile_line(random_) for _ in range(3000)]
        line = Line()
        await server.converse(lines_of(HELLO, *lines), line)
        assert len(line.said) == 3001
        assert all("answer" in each for each in line.said)
        assert len(loop.steps) > 100

    run(act)


def test_programs_at_once_never_put_two_steps_into_the_slot() -> None:
    async def act(server: ControlServer, loop: Loop) -> None:
        asked = [HELLO, *[VALID[1], {"type": "trigger", "effect": "tick", "finger": 3}] * 50]
        lines = [Line() for _ in range(MOST_PROGRAMS)]
        await asyncio.gather(*[server.converse(lines_of(*asked), line) for line in lines])
        assert [len(line.said) for line in lines] == [101] * MOST_PROGRAMS
        assert len(loop.steps) == MOST_PROGRAMS * 101  # the last of each ends what it held

    run(act)


def test_one_program_too_many_is_told_so() -> None:
    async def act(server: ControlServer, _loop: Loop) -> None:
        held = [asyncio.create_task(server.converse(lines_of(forever=True), Line())) for _ in range(MOST_PROGRAMS)]
        await asyncio.sleep(0)
        line = Line()
        await server.converse(lines_of(HELLO), line)
        assert [each["ok"] for each in line.said] == [False] and "end one of them" in line.said[0]["error"]
        for task in held:
            task.cancel()
        await asyncio.gather(*held, return_exceptions=True)

    run(act)


@pytest.mark.machine
def test_a_connection_that_never_greets_is_closed_and_one_that_greeted_is_not() -> None:
    async def act(server: ControlServer, _loop: Loop) -> None:
        server._greet_within_s = 0.05
        silent, babbling, greeting = Line(), Line(), Line()
        talk = asyncio.create_task(server.converse(lines_of(HELLO, forever=True), greeting))
        await server.converse(lines_of(forever=True), silent)
        await server.converse(lines_of({"type": "ping"}, forever=True), babbling)
        assert [each["error"] for each in silent.said] == ["run: no hello within 0.05 s: the connection is closed"]
        assert len(babbling.said) == 2 and "no hello" in babbling.said[1]["error"]
        assert len(server._programs) == 1 and not talk.done()
        talk.cancel()
        await asyncio.gather(talk, return_exceptions=True)

    run(act)


def test_an_effect_file_is_defined_with_a_report_and_its_name_ends_with_the_program() -> None:
    async def act(server: ControlServer, _loop: Loop) -> None:
        line = Line()
        content = json.loads((ROOT / "tables" / "effects" / "knock.ahap").read_text(encoding="utf-8"))
        define = {"type": "define", "name": "knock", "format": "ahap", "content": content}
        await server.converse(lines_of(HELLO, define, {"type": "trigger", "effect": "knock", "finger": 3}), line)
        assert [each["fate"] for each in line.said[1]["events"]] == ["kept", "kept", "kept"]
        assert line.said[2]["ok"] and "knock" not in server.scene.effects

    run(act)


def test_after_a_change_of_table_positions_are_those_of_the_new_device() -> None:
    async def act(server: ControlServer, loop: Loop) -> None:
        server.adopt(find_device("reference-t"))
        line = Line()
        await server.converse(lines_of(HELLO, VALID[1]), line)
        device = find_device("reference-t")
        assert line.said[0]["device"] == "reference-t"
        assert [zone["stop_m"] for zone in line.said[0]["zones"]] == [zone.stop_m for zone in device.zones]
        rules = loop.steps[0].effects
        assert rules is not None and rules.rules[0].region_m == pytest.approx((0.01, 0.3 * device.bar.length_m))

    run(act)


def test_a_finger_that_is_not_there_is_named_with_those_that_are() -> None:
    async def act(server: ControlServer, _loop: Loop) -> None:
        line = Line()
        away = {"type": "trigger", "effect": "tick", "finger": 9}
        await server.converse(lines_of(HELLO, away, {"type": "role", "finger": 9, "role": "quiet"}), line)
        for answer, key in zip(line.said[1:], ("trigger", "role"), strict=True):
            assert answer["error"] == f"{key}.finger: 9: does not touch the bar; of these that do: 3"

    run(act)


@pytest.mark.parametrize("reads", [True, False])
def test_a_program_that_reads_too_slowly_loses_events_and_is_told_how_many(reads: bool) -> None:
    async def act(server: ControlServer, _loop: Loop) -> None:
        line = Line(reads=reads)
        talk = lines_of(HELLO, {"type": "subscribe", "to": ["touches"]}, forever=True)
        talking = asyncio.create_task(server.converse(talk, line))
        while len(line.said) < 2:
            await asyncio.sleep(0)
        event = {"event": "touches", "time_ns": 1, "fingers": FINGERS * 50}
        server.publish([event] * 200)
        got = len(line.said) - 2
        assert got == 200 if reads else got < 200 and line.unread_bytes() < 2 * MOST_UNREAD_BYTES
        line._unread = 0
        server.publish([event])
        assert ({"event": "lost", "count": 200 - got} in line.said) is not reads
        talking.cancel()
        await asyncio.gather(talking, return_exceptions=True)

    run(act)


@pytest.mark.machine
def test_another_run_gets_the_scene_with_its_own_rules_below_and_no_roles_of_the_one_before() -> None:
    async def act(server: ControlServer, loop: Loop) -> None:
        line, more = Line(), Effects((), BASE.others)
        talk = asyncio.ensure_future(
            server.converse(lines_of(VALID[0] | {"lease": "60 s"}, VALID[1], VALID[10], forever=True), line)
        )
        while len(line.said) < 3:
            await asyncio.sleep(0.01)
        await server.begin_run(more)
        assert loop.steps[-1].effects == server.scene.rules() and server.scene.base == more
        assert list(server.scene.regions) == ["ok"] and loop.steps[-1].effects != more
        await server.remove_regions()
        assert loop.steps[-1].effects == more and server.scene.regions == {}
        talk.cancel()
        await asyncio.gather(talk, return_exceptions=True)
        assert all(step.roles in ((), ((3, True),)) for step in loop.steps)  # nothing ends that has ended

    run(act)
