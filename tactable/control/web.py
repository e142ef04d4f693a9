"""Programs in browsers: the control channel as a WebSocket on loopback, whose address holds a token.

A page of any origin may connect if it knows the token, which only the run's output has: an application's page comes
from its own server or from a file. The Host header must name this machine, so that no foreign name leads here.
"""

import asyncio
import contextlib
from collections.abc import AsyncIterator

from starlette.applications import Starlette
from starlette.routing import WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from tactable.control.control_server import ControlServer
from tactable.control.requests import MOST_BYTES
from tactable.control.security import GRACE_S, LOOPBACK, listen_at, new_token, quiet_server

_LONGEST_MESSAGE = 64 * MOST_BYTES  # beyond it the WebSocket is closed; up to it a message that is too long is answered


class _Browser:
    """The way back to one program in a browser."""

    def __init__(self, socket_: WebSocket) -> None:
        self._socket = socket_
        self._lines: asyncio.Queue[bytes] = asyncio.Queue()
        self._unread = 0

    def send(self, line: bytes) -> None:
        self._unread += len(line)
        self._lines.put_nowait(line)

    async def drain(self) -> None:
        await self._lines.join()

    def unread_bytes(self) -> int:
        return self._unread

    async def run(self) -> None:
        """Send what waits, until cancelled or disconnected."""
        while True:
            line = await self._lines.get()
            with contextlib.suppress(WebSocketDisconnect, RuntimeError):  # it is gone: the listener ends the talk
                await self._socket.send_text(line.decode().rstrip("\n"))
            self._unread -= len(line)
            self._lines.task_done()

    async def messages(self) -> AsyncIterator[bytes]:
        """What the browser sends, until it disconnects."""
        while (message := await self._socket.receive())["type"] != "websocket.disconnect":
            text = message.get("text")
            yield message.get("bytes") or b"" if text is None else text.encode(errors="surrogatepass")


class WebControl:
    """The WebSocket of one control server; port 0 takes any free one. Raises AddressError for a port that is taken."""

    def __init__(self, server: ControlServer, port: int) -> None:
        self._server = server
        self._listening, self._access = listen_at(LOOPBACK[0], port, new_token())
        app = Starlette(routes=[WebSocketRoute("/{token}/control", self._talk)])
        self._uvicorn = quiet_server(app, _LONGEST_MESSAGE)

    @property
    def address(self) -> str:
        """Address that a program connects to."""
        return f"ws://{self._access.host}:{self._access.port}/{self._access.token}/control"

    async def run(self) -> None:
        """Serve until `end`."""
        await self._uvicorn.serve(sockets=[self._listening])

    def end(self) -> None:
        """Disconnect all programs and stop."""
        self._uvicorn.should_exit = True

    async def _talk(self, socket_: WebSocket) -> None:
        if not self._access.admits(socket_):
            await socket_.close()  # before it is accepted: 403
            return
        await socket_.accept()
        browser = _Browser(socket_)
        sending = asyncio.create_task(browser.run())
        try:
            await self._server.converse(browser.messages(), browser)
            with contextlib.suppress(TimeoutError, RuntimeError, WebSocketDisconnect):  # it is gone already
                await asyncio.wait_for(browser.drain(), GRACE_S)
                await socket_.close()
        finally:
            sending.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await sending
