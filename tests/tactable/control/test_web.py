"""The control channel as a WebSocket: the token and the Host decide who may speak, and all that is said is answered."""

import asyncio
import json
from collections.abc import Awaitable, Callable

import pytest
import websockets
from websockets.asyncio.client import connect
from websockets.typing import Origin

from base.child import ChildError
from tactable.control.server import ControlServer
from tactable.control.web import WebControl
from tests.tactable.control.messages import HELLO, VALID
from tests.tactable.control.virtual import FINGERS, VirtualSlot, server_of

pytestmark = pytest.mark.usefixtures("both_ends")


def run(act: Callable[[WebControl, ControlServer, VirtualSlot], Awaitable[None]]) -> None:
    async def started() -> None:
        loop = VirtualSlot(polls=True)
        server = server_of(loop)
        web = WebControl(server, 0)
        serving = asyncio.create_task(web.run())
        try:
            await act(web, server, loop)
        finally:
            web.end()
            await serving

    asyncio.run(started())


def test_a_page_says_what_its_buttons_feel_like_and_loses_them_when_it_closes() -> None:
    async def act(web: WebControl, server: ControlServer, loop: VirtualSlot) -> None:
        async with connect(web.address, origin=Origin("null")) as page:
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
        while server.scene.regions or len(loop.steps) < 2:
            await asyncio.sleep(0.01)

    run(act)


def test_a_text_that_is_not_utf_8_closes_its_own_connection_and_prints_nothing(
    capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    async def act(web: WebControl, _server: ControlServer, _loop: VirtualSlot) -> None:
        async with connect(web.address, origin=Origin("null")) as page:
            await page.send(b"\xff\xfe", text=True)
            with pytest.raises(websockets.ConnectionClosed) as closed:
                await page.recv()
        assert closed.value.rcvd is not None and closed.value.rcvd.code == 1007
        async with connect(web.address, origin=Origin("null")) as page:
            await page.send(json.dumps(HELLO))
            assert json.loads(await page.recv())["ok"]

    run(act)
    assert capfd.readouterr() == ("", "") and caplog.text == ""


@pytest.mark.parametrize("wrong", ["token", "host"])
def test_without_the_token_or_by_a_foreign_name_nobody_speaks(wrong: str) -> None:
    async def act(web: WebControl, server: ControlServer, _loop: VirtualSlot) -> None:
        port = int(web.address.split(":")[2].split("/")[0])
        address = web.address.replace("/control", "x/control")
        if wrong == "host":
            address = web.address.replace("127.0.0.1", "foreign.example")
        with pytest.raises(websockets.exceptions.InvalidStatus, match="403"):
            async with connect(address, host="127.0.0.1", port=port):
                pass
        assert not server.wanted_streams

    run(act)


def test_a_port_that_is_taken_is_named() -> None:
    async def act(web: WebControl, server: ControlServer, _loop: VirtualSlot) -> None:
        taken = int(web.address.split(":")[2].split("/")[0])
        with pytest.raises(ChildError, match=f"port {taken}: .*choose another"):
            WebControl(server, taken)

    run(act)
