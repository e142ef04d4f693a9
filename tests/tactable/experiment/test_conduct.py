"""Conducting on virtual time: what is played where and asked, what is not played as asked, and the page that asks."""

import asyncio
import csv
import json
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import httpx
import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus
from websockets.typing import Origin

from tactable.control.client import ClientError
from tactable.control.security import HEADERS, listen_at, new_token
from tactable.experiment.conduct import Screen, conduct, serve_questions
from tactable.experiment.protocol import ExperimentError, parse_protocol
from tactable.experiment.session import Session
from tactable.experiment.stage import LiveStage
from tactable.experiment.trial_files import SessionFiles
from tests.tactable.control.virtual import on_virtual_time
from tests.tactable.experiment.test_session import DEVICE

PLACES = {5: 0.045, 2: 0.17}
PROTOCOL = parse_protocol(
    """
name = "x"
[[task]]
name = "beside"
kind = "masked"
fingers = ["45 mm", "170 mm"]
base = "12 dB"
levels = ["-12 dB", "12 dB"]
trials = 3
practice = 1
catch = 1
""",
    "x",
    DEVICE,
)


class Run:
    """A run as its client sees it: fingers that rest, and triggers that it plays, but for those it spoils."""

    def __init__(self, spoiled: frozenset[int] = frozenset()) -> None:
        self.run = {"device": "reference-a"}
        self.asked: list[dict[str, Any]] = []
        self.touches = [{"finger": finger, "at_m": at_m} for finger, at_m in PLACES.items()]
        self._spoiled, self._triggers = spoiled, 0
        self._events: asyncio.Queue[dict[str, Any] | None] = asyncio.Queue()

    async def ask(self, message: dict[str, Any]) -> dict[str, Any]:
        self.asked.append({**message, "at_s": asyncio.get_running_loop().time()})
        if message["type"] == "trigger":
            self._triggers += 1
            kind = "drive" if self._triggers in self._spoiled else "click"
            roles = [("felt" if finger == message["finger"] else "quiet", finger) for finger in PLACES]
            event = {"event": "played", "kind": kind, "time_ns": round(asyncio.get_running_loop().time() * 1e9)}
            fingers = [{"role": role, "finger": finger} for role, finger in roles]
            self.say({**event, "fingers": fingers, "promise": None, "frequencies_hz": []})
        return {"fingers": self.touches}

    def say(self, event: dict[str, Any] | None) -> None:
        self._events.put_nowait(event)

    def rest(self, *fingers: int) -> None:
        self.touches = [{"finger": finger, "at_m": PLACES[finger]} for finger in fingers]
        self.say({"event": "touches", "fingers": self.touches})

    async def events(self) -> AsyncIterator[dict[str, Any]]:
        while (event := await self._events.get()) is not None:
            yield event

    def triggers(self) -> list[tuple[int, str]]:
        return [(each["finger"], each["level_change"]) for each in self.asked if each["type"] == "trigger"]


async def run_to_end(run: Run, folder: Path, press: Callable[[Screen], dict[str, Any] | None]) -> list[dict[str, str]]:
    """Conduct with a participant who does what `press` says of each state; the rows of the file."""
    stage = await LiveStage.on(run, PROTOCOL, "reference-a")  # type: ignore[arg-type]  # it behaves as one
    folder.mkdir(exist_ok=True)
    screen, files, session = Screen(), SessionFiles.of(folder, PROTOCOL, "01"), Session(PROTOCOL, "01")

    def pressed() -> None:
        if (message := press(screen)) is not None:
            asyncio.get_running_loop().call_later(0.25, screen.receive, message)

    screen.on_change = pressed
    try:
        await conduct(session, stage, screen, files, "consent")
    finally:
        await stage.close()
    assert screen.state["kind"] == "done"
    return list(csv.DictReader(files.path("beh.csv").read_text().splitlines()))


def first(screen: Screen) -> dict[str, Any] | None:
    state = screen.state
    return {"number": state["number"], "choice": 0, "after_ms": 250} if state["choices"] else None


@on_virtual_time
async def test_every_trial_is_played_asked_and_kept(tmp_path: Path) -> None:
    run = Run()
    rows = await run_to_end(run, tmp_path, first)
    assert len(rows) == 8 and {row["answer"] for row in rows} == {"first"}
    assert {row["correct"] for row in rows if row["side"] == "0"} == {"1"}
    masking = 2 * len(rows)
    tested = [row for row in rows if row["level_db"]]
    assert len(run.triggers()) == masking + len(tested)
    assert all(95 < float(row["gap_ms"]) < 110 for row in tested)
    asked = [(finger, f"{float(row['level_db']):g} dB") for row in tested for finger in [(5, 2)[int(row["finger"])]]]
    assert [each for each in run.triggers() if each in asked]
    assert {"type": "settings", "rule_file": False}.items() <= run.asked[0].items()


@on_virtual_time
async def test_what_is_not_played_as_asked_is_played_again_and_never_kept(tmp_path: Path) -> None:
    plain, spoiled = Run(), Run(frozenset({1, 5, 6}))
    kept = await run_to_end(plain, tmp_path / "plain", first)
    again = await run_to_end(spoiled, tmp_path / "spoiled", first)
    assert len(spoiled.triggers()) > len(plain.triggers())
    columns = ("trial", "role", "finger", "side", "level_db", "answer")
    assert [[row[name] for name in columns] for row in again] == [[row[name] for name in columns] for row in kept]


@on_virtual_time
async def test_a_run_that_never_plays_what_is_asked_ends_with_the_remedy(tmp_path: Path) -> None:
    with pytest.raises(ClientError, match="trials in a row were not played as asked: see that the fingers rest"):
        await run_to_end(Run(frozenset(range(100))), tmp_path, first)


@on_virtual_time
async def test_a_run_that_ends_is_said_so_and_answers_are_kept(tmp_path: Path) -> None:
    def press(screen: Screen) -> dict[str, Any] | None:
        if screen.state["kind"] == "question":
            run.say(None)
        return first(screen)

    run = Run()
    with pytest.raises(ExperimentError, match="the run has ended: start it again, then this command"):
        await run_to_end(run, tmp_path, press)
    assert len((tmp_path / "sub-01_task-x_beh.csv").read_text().splitlines()) == 2


@on_virtual_time
async def test_nothing_is_played_until_both_fingers_rest(tmp_path: Path) -> None:
    run, shown = Run(), []
    run.touches = run.touches[:1]

    def press(screen: Screen) -> dict[str, Any] | None:
        shown.append(screen.state["kind"])
        if shown[-1] == "fingers":
            assert run.triggers() == [] and "45 mm and 170 mm" in screen.state["text"]
            asyncio.get_running_loop().call_later(2.0, run.rest, 5, 2)
        return first(screen)

    assert len(await run_to_end(run, tmp_path, press)) == 8 and shown.count("fingers") == 1


@on_virtual_time
async def test_stop_is_silence_until_the_participant_goes_on(tmp_path: Path) -> None:
    run, has_stopped = Run(), list[str]()

    def press(screen: Screen) -> dict[str, Any] | None:
        if screen.state["kind"] == "interval" and not has_stopped:
            has_stopped.append("once")
            return {"stop": True}
        if screen.state["kind"] == "stopped":
            assert run.asked[-1]["type"] == "settings" and run.asked[-1]["enabled"] is False
            has_stopped.append("shown")
        return first(screen)

    assert len(await run_to_end(run, tmp_path, press)) == 8 and has_stopped == ["once", "shown"]


@on_virtual_time
async def test_the_page_shows_no_level_and_takes_one_answer_to_the_question_that_it_shows(tmp_path: Path) -> None:
    def press(screen: Screen) -> dict[str, Any] | None:
        state = screen.state
        assert "dB" not in state["text"] and set(state) == {
            *("number", "kind", "text", "choices", "lit", "intervals"),
            "done",
        }
        now = {"number": state["number"], "choice": 1, "after_ms": 1}
        for wrong in ({"number": now["number"] - 1}, {"choice": 7}, {"choice": True}, {"after_ms": float("nan")}):
            screen.receive({**now, **wrong})
        return first(screen)

    assert {row["answer"] for row in await run_to_end(Run(), tmp_path, press)} == {"first"}


@on_virtual_time
async def test_a_run_of_another_device_is_refused() -> None:
    with pytest.raises(ExperimentError, match="the run plays reference-a, and the table is of mine"):
        await LiveStage.on(Run(), PROTOCOL, "mine")  # type: ignore[arg-type]


@pytest.mark.usefixtures("both_ends")
def test_the_page_is_behind_its_token_and_shows_the_present_question_again() -> None:
    answered: list[tuple[int, float]] = []

    async def visit() -> None:
        screen, (listening, access) = Screen(), listen_at("127.0.0.1", 0, new_token())

        async def work() -> None:
            asking = asyncio.create_task(screen.ask("question", "Which?", ("first", "second")))
            url, own = access.url, Origin(f"http://127.0.0.1:{access.port}")
            async with httpx.AsyncClient() as client:
                page = await client.get(url)
                assert page.status_code == 200 and "question.js" in page.text
                assert all(page.headers[name] == text for name, text in HEADERS.items())
                assert (await client.get(url + "conduct.py")).status_code == 404
                assert (await client.get(url.replace(access.token, new_token()))).status_code == 403
            socket = url.replace("http:", "ws:") + "answers"
            for address, origin in ((socket, Origin("http://evil")), (socket.replace(access.token, new_token()), own)):
                with pytest.raises(InvalidStatus):
                    await connect(address, origin=origin)
            for _ in range(2):
                async with connect(socket, origin=own) as page_socket:
                    shown = json.loads(await page_socket.recv())
                    assert shown["text"] == "Which?"
                    for wrong in ("no JSON", "[]", "[" * 900, "{}"):
                        await page_socket.send(wrong)
            async with connect(socket, origin=own) as page_socket:
                shown = json.loads(await page_socket.recv())
                await page_socket.send(json.dumps({"number": shown["number"], "choice": 1, "after_ms": 40}))
                answered.append(await asking)

        with listening:
            await serve_questions(screen, listening, access, work())

    asyncio.run(visit())
    assert answered == [(1, 40.0)]
