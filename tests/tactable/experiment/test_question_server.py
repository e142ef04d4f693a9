"""The question page: who is let in, and that a page which connects again sees the present question."""

import asyncio
import json

import httpx
import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus
from websockets.typing import Origin

from tactable.control.security import HEADERS, listen_at, new_token
from tactable.experiment.conduct import Screen
from tactable.experiment.question_server import serve_questions

pytestmark = pytest.mark.usefixtures("both_ends")


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
