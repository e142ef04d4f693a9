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

from tactable.control.security import AccessPolicy, quiet_server
from tactable.experiment.conduct import Screen
from tactable.page.page_server import answer_file, files_of

MOST_BYTES = 1024
MOST_BROWSERS = 8
_STATIC = Path(__file__).parent / "static"
_ICON = Path(__file__).parents[1] / "page" / "static" / "icon.svg"


class QuestionServer:
    """Serves one screen under one access policy. A browser that connects again sees the present state at once."""

    def __init__(self, screen: Screen, access: AccessPolicy) -> None:
        self._screen, self._access = screen, access
        self._browsers: dict[WebSocket, asyncio.Event] = {}
        self._files = files_of((*_STATIC.iterdir(), _ICON))
        screen.on_change = self._tell
        files = [Route("/{token}/", self._answer_file), Route("/{token}/{name}", self._answer_file)]
        self.app = Starlette(routes=[WebSocketRoute("/{token}/answers", self._converse), *files])
        self.app.router.redirect_slashes = False

    async def _answer_file(self, request: Request) -> Response:
        return await answer_file(request, self._access, self._files, "question.html")

    async def _converse(self, socket_: WebSocket) -> None:
        if not self._access.admits(socket_, is_own_page=True) or len(self._browsers) >= MOST_BROWSERS:
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
