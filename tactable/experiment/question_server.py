"""The question page: its files and one WebSocket of JSON for each browser, behind a token, to a `Screen`."""

import asyncio
import contextlib
import json
import socket
from collections.abc import Coroutine
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from tactable.control.security import HEADERS, AccessPolicy, quiet_server
from tactable.experiment.conduct import Screen

MOST_BYTES = 1024
MOST_BROWSERS = 8
_STATIC = Path(__file__).parent / "static"
_ICON = Path(__file__).parents[1] / "page" / "static" / "icon.svg"
_TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
_FILES = {path.name: path for path in (*_STATIC.iterdir(), _ICON)}


class QuestionServer:
    """Serves one screen under one access policy. A browser that connects again sees the present state at once."""

    def __init__(self, screen: Screen, access: AccessPolicy) -> None:
        self._screen, self._access = screen, access
        self._browsers: dict[WebSocket, asyncio.Event] = {}
        self._is_over = False
        screen.on_change = self._tell
        files = [Route("/{token}/", self._answer_file), Route("/{token}/{name}", self._answer_file)]
        self.app = Starlette(routes=[WebSocketRoute("/{token}/answers", self._converse), *files])
        self.app.router.redirect_slashes = False

    async def _answer_file(self, request: Request) -> Response:
        name = request.path_params.get("name", "question.html")
        if not self._admits(request.headers.get("host"), request.path_params["token"]):
            return Response("refused: open the address that tactable printed\n", 403, HEADERS)
        if name not in _FILES:
            return Response("there is no such file\n", 404, HEADERS)
        return Response(_FILES[name].read_bytes(), 200, HEADERS, media_type=_TYPES[_FILES[name].suffix])

    async def _converse(self, socket_: WebSocket) -> None:
        host, origin = socket_.headers.get("host"), socket_.headers.get("origin")
        is_admitted = self._admits(host, socket_.path_params["token"]) and self._access.admits_origin(origin, host)
        if not is_admitted or len(self._browsers) >= MOST_BROWSERS:
            await socket_.close()
            return
        await socket_.accept()
        self._browsers[socket_] = news = asyncio.Event()
        news.set()
        sending = asyncio.create_task(self._send(socket_, news))
        try:
            while True:
                with contextlib.suppress(ValueError, RecursionError):  # what is no JSON is no answer
                    message = json.loads(await socket_.receive_text())
                    if isinstance(message, dict):
                        self._screen.receive(message)
        except (WebSocketDisconnect, KeyError, RuntimeError):  # gone, or bytes in place of text
            pass
        finally:
            del self._browsers[socket_]
            sending.cancel()

    async def _send(self, socket_: WebSocket, news: asyncio.Event) -> None:
        """Send the newest state as fast as the browser takes it; states between are left out."""
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            while True:
                await news.wait()
                news.clear()
                await socket_.send_text(json.dumps(self._screen.state))

    def _tell(self) -> None:
        for news in self._browsers.values():
            news.set()

    def _admits(self, host: str | None, token: str) -> bool:
        return self._access.admits_host(host) and self._access.knows(token)


async def serve_questions(
    screen: Screen, listening: socket.socket, access: AccessPolicy, work: Coroutine[Any, Any, None]
) -> None:
    """Serve the page while `work` goes on, and a moment longer, so that its last word is shown; raises as `work`."""
    server = quiet_server(QuestionServer(screen, access).app, MOST_BYTES)
    serving, working = asyncio.create_task(server.serve(sockets=[listening])), asyncio.create_task(work)
    await asyncio.wait({serving, working}, return_when=asyncio.FIRST_COMPLETED)
    if not working.done():  # a signal ended the server
        working.cancel()
    await asyncio.sleep(0.2)
    server.should_exit = True
    await serving
    with contextlib.suppress(asyncio.CancelledError):
        await working
