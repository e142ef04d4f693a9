"""The control channel as a WebSocket: the token and the Host decide who may speak, and all that is said is answered."""

import asyncio
import functools
import json
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from typing import Any, ParamSpec

import pytest
import websockets
from websockets.asyncio.client import connect
from websockets.typing import Origin

from tactable.control.control_server import ControlServer
from tactable.control.security import AddressError
from tactable.control.web import WebControl
from tests.tactable.control.messages import HELLO, VALID
from tests.tactable.control.virtual import FINGERS, VirtualSlot

pytestmark = pytest.mark.usefixtures("both_ends")


P = ParamSpec("P")


def in_real_time(test: Callable[P, Coroutine[Any, Any, None]]) -> Callable[P, None]:
    """Make a test of a coroutine, whose arguments are fixtures."""
    return functools.wraps(test)(lambda *args, **fixtures: asyncio.run(test(*args, **fixtures)))


@asynccontextmanager
async def served(server: ControlServer) -> AsyncIterator[WebControl]:
    web = WebControl(server, 0)
    serving = asyncio.create_task(web.run())
    try:
        yield web
    finally:
        web.end()
        await serving


@in_real_time
async def test_a_page_says_what_its_buttons_feel_like_and_loses_them_when_it_closes(
    server: ControlServer, slot: VirtualSlot
) -> None:
    async with served(server) as web, connect(web.address, origin=Origin("null")) as page:
        answers = []
        for message in (HELLO, VALID[1], {"type": "subscribe", "to": ["touches"]}, {"type": "nonsense"}):
            await page.send(json.dumps(message))
            answers.append(json.loads(await page.recv()))
        assert [each["ok"] for each in answers] == [True, True, True, False]
        assert list(server.scene.regions) == ["ok"]
        server.publish([{"event": "touches", "time_ns": 1, "fingers": FINGERS}])
        assert json.loads(await page.recv())["fingers"] == FINGERS
        await page.send(b"\xff")
        assert json.loads(await page.recv())["ok"] is False
        await page.close()
        while server.scene.regions or len(slot.steps) < 2:
            await asyncio.sleep(0.01)


@in_real_time
async def test_a_text_that_is_not_utf_8_closes_its_own_connection_and_prints_nothing(
    server: ControlServer, capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    async with served(server) as web:
        async with connect(web.address, origin=Origin("null")) as page:
            await page.send(b"\xff\xfe", text=True)
            with pytest.raises(websockets.ConnectionClosed) as closed:
                await page.recv()
        assert closed.value.rcvd is not None and closed.value.rcvd.code == 1007
        async with connect(web.address, origin=Origin("null")) as page:
            await page.send(json.dumps(HELLO))
            assert json.loads(await page.recv())["ok"]
    assert capfd.readouterr() == ("", "") and caplog.text == ""


@in_real_time
async def test_without_the_token_or_by_a_foreign_name_nobody_speaks_and_a_port_that_is_taken_is_named(
    server: ControlServer,
) -> None:
    async with served(server) as web:
        port = int(web.address.split(":")[2].split("/")[0])
        for right, wrong in (("/control", "x/control"), ("127.0.0.1", "foreign.example")):
            with pytest.raises(websockets.exceptions.InvalidStatus, match="403"):
                await connect(web.address.replace(right, wrong), host="127.0.0.1", port=port)
        with pytest.raises(AddressError, match=f"port {port}: .*give another port"):
            WebControl(server, port)
