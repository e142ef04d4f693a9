"""The web server of the page: static files, and one WebSocket for each browser.

Who waits for whom. One asyncio loop runs three kinds of tasks. `broadcast` ticks the backend up to 60 times a second
and offers every browser the messages of the tick; it never waits for a browser. Each browser has a sender, which waits
for its socket alone: of every kind of message it keeps only the newest that is not sent, so a slow browser misses
pictures and delays nobody. Each browser also has a listener, which hands decoded messages to the backend at once. The
backend's own `run` starts and watches its processes beside them. If `broadcast` or `run` fails, the server ends with
that error.
"""

import asyncio
import contextlib
import secrets
import socket
import time
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from engine.touch.sources.pointer import PointerEvent
from tactable.control.security import HEADERS, AccessPolicy, quiet_server, read_connections, user_of
from tactable.page.page_messages import (
    MOST_BYTES,
    CloseCode,
    DroppedFile,
    Kind,
    PageMessageError,
    decode_message,
    encode_scene,
)

FRAME_S = 1 / 60  # of most screens
IDLE_FRAMES = 12
"""While nothing happens, one picture in this many is sent."""
ALONE_S = 0.1
"""Time between two ticks while no browser is connected."""
MOST_BROWSERS = 8
_STATIC = Path(__file__).parent / "static"
_TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}


class PageBackend(ABC):
    """Source of what the page shows, and what its browsers may change in it: nothing, where it only looks on."""

    scene_number = 0
    """Changes whenever the scene does."""

    @abstractmethod
    def scene(self) -> dict[str, Any]:
        """The part of the state that changes seldom, as JSON values."""

    @abstractmethod
    def tick(self) -> tuple[list[bytes], bool]:
        """Advance to the present; the messages for all browsers, and whether anything moves."""

    def touch(self, browser: int, events: Sequence[PointerEvent]) -> None:  # noqa: B027  # one that only looks on takes nothing
        """Take pointer events of a browser."""

    def leave(self, browser: int) -> None:  # noqa: B027  # one that only looks on takes nothing
        """Release the pointers of a browser that disconnected."""

    def choose(self, switches: dict[str, Any]) -> None:  # noqa: B027  # one that only looks on takes nothing
        """Move switches."""

    def drop(self, file: DroppedFile) -> None:  # noqa: B027  # one that only looks on takes nothing
        """Take a device file that was dropped on the page."""

    @abstractmethod
    def sound(self, finger: int) -> bytes | None:
        """Vibration that a finger felt, as a SOUND message; None where it is not known."""

    @abstractmethod
    async def run(self) -> None:
        """Do the background work until cancelled."""


class _Browser:
    """The messages that wait for one browser: the newest of each kind."""

    def __init__(self, socket_: WebSocket) -> None:
        self._socket = socket_
        self._news: dict[int, bytes] = {}
        self._has_news = asyncio.Event()

    def offer(self, message: bytes) -> None:
        """Queue a message in place of an older one of its kind that is not sent yet."""
        self._news[message[1]] = message
        self._has_news.set()

    async def send(self) -> None:
        """Send what is queued, as fast as the browser takes it, until cancelled."""
        while True:
            await self._has_news.wait()
            self._has_news.clear()
            for kind in Kind:
                message = self._news.pop(kind, None)
                if message is not None:
                    await self._socket.send_bytes(message)


class PageServer:
    """One backend, served under one access policy to at most MOST_BROWSERS browsers.

    connections: the lines that tell whose a connection is.
    """

    def __init__(
        self, backend: PageBackend, access: AccessPolicy, connections: Callable[[], Iterable[str]] = read_connections
    ) -> None:
        self.backend, self.access = backend, access
        self._connections = connections
        self._browsers: dict[int, _Browser] = {}
        self._opened = 0
        self._has_ticket = True
        self._files = files_of(_STATIC.iterdir())
        routes = [
            Route("/open/{ticket}", self._answer_ticket),
            Route("/{token}/", self._answer_file),
            Route("/{token}/{name}", self._answer_file),
            WebSocketRoute("/{token}/socket", self._answer_socket),
        ]
        self.app = Starlette(routes=routes, exception_handlers={404: _refused, 405: _refused})
        self.app.router.redirect_slashes = False  # it would answer before token and Host are looked at

    async def _answer_ticket(self, request: Request) -> Response:
        """Lead the browser that was opened for this user to the page, once."""
        is_right = secrets.compare_digest(request.path_params["ticket"].encode(), self.access.ticket.encode())
        if not (self._has_ticket and is_right and self.access.admits_host(request.headers.get("host"))):
            return await _refused(request, None)
        browser, server = request.scope["client"], request.scope["server"]
        if user_of(browser, server, self._connections()) != self.access.user_id:
            return await _refused(request, None)
        self._has_ticket = False
        return Response(status_code=303, headers={**HEADERS, "Location": f"/{self.access.token}/"})

    async def _answer_file(self, request: Request) -> Response:
        return await answer_file(request, self.access, self._files, "index.html")

    async def _answer_socket(self, socket_: WebSocket) -> None:
        if not self.access.admits(socket_, is_own_page=True):
            await socket_.close()  # before it is accepted: 403
            return
        await socket_.accept()
        if len(self._browsers) >= MOST_BROWSERS:
            await socket_.close(CloseCode.CROWDED, f"{MOST_BROWSERS} browsers look on already")
            return
        await self._serve(socket_)

    async def _serve(self, socket_: WebSocket) -> None:
        self._opened += 1
        number, browser = self._opened, _Browser(socket_)
        browser.offer(encode_scene(self.backend.scene()))
        self._browsers[number] = browser
        sender = asyncio.create_task(browser.send())
        try:
            await self._listen(number, socket_, browser)
        except PageMessageError as error:
            await socket_.close(error.code, str(error)[:100])
        except WebSocketDisconnect:
            pass
        finally:
            del self._browsers[number]
            self.backend.leave(number)
            sender.cancel()
            with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                await sender

    async def _listen(self, number: int, socket_: WebSocket, browser: _Browser) -> None:
        while True:
            message = await socket_.receive()
            if message["type"] == "websocket.disconnect":
                return
            data = message.get("bytes")
            if data is None:
                raise PageMessageError(CloseCode.NOT_BINARY, "a message of text; expected bytes")
            asked = decode_message(data)
            if isinstance(asked, tuple):
                self.backend.touch(number, asked)
            elif isinstance(asked, dict):
                self.backend.choose(asked)
            elif isinstance(asked, DroppedFile):
                self.backend.drop(asked)
            elif (sound := self.backend.sound(asked)) is not None:
                browser.offer(sound)

    async def broadcast(self) -> None:
        """Tick the backend and offer its messages to all browsers, until cancelled."""
        scene_number, idle, due_s = self.backend.scene_number, 0, time.monotonic()
        while True:
            began_s = time.monotonic()
            messages, is_busy = self.backend.tick()
            idle = 0 if is_busy else idle + 1
            if idle % IDLE_FRAMES:
                messages = [message for message in messages if message[1] != Kind.PICTURE]
            if scene_number != self.backend.scene_number:
                scene_number = self.backend.scene_number
                messages.insert(0, encode_scene(self.backend.scene()))
            for browser in self._browsers.values():
                for message in messages:
                    browser.offer(message)
            # A late machine leaves pictures out instead of catching up, and a tick takes at most half of the time.
            now_s = time.monotonic()
            due_s = max(due_s + (FRAME_S if self._browsers else ALONE_S), now_s + max(now_s - began_s, FRAME_S / 4))
            await asyncio.sleep(due_s - now_s)


def files_of(paths: Iterable[Path]) -> dict[str, bytes]:
    """The files of a page, by name."""
    return {path.name: path.read_bytes() for path in paths if path.suffix in _TYPES}


async def answer_file(request: Request, access: AccessPolicy, files: Mapping[str, bytes], first: str) -> Response:
    """One of the files that a request names, `first` where it names none, to who knows the token."""
    name = request.path_params.get("name", first)
    if not access.admits(request):
        return await _refused(request, None)
    if name not in files:
        return Response("there is no such file\n", 404, HEADERS)
    return Response(files[name], 200, HEADERS, media_type=_TYPES[Path(name).suffix])


async def _refused(_request: Request, _error: Exception | None) -> Response:
    return Response("refused: open the address that tactable printed\n", 403, HEADERS)


async def serve(
    backend: PageBackend,
    listening: socket.socket,
    access: AccessPolicy,
    on_start: Callable[[uvicorn.Server], Awaitable[None]] | None = None,
) -> None:
    """Serve a backend until a signal, or until `on_start` makes the server exit. Raises what the backend raised."""
    page = PageServer(backend, access)
    server = quiet_server(page.app, MOST_BYTES)
    beside = [asyncio.create_task(backend.run()), asyncio.create_task(page.broadcast())]
    for task in beside:
        task.add_done_callback(lambda done: _end_if_broken(done, server))
    try:
        if on_start is not None:
            await on_start(server)
        await server.serve(sockets=[listening])
    finally:
        for task in beside:
            task.cancel()
        results = await asyncio.gather(*beside, return_exceptions=True)
    for result in results:
        if isinstance(result, Exception):
            raise result


def _end_if_broken(done: "asyncio.Task[None]", server: uvicorn.Server) -> None:
    """A background task that failed ends the server; `serve` raises its error."""
    if not done.cancelled():
        server.should_exit = True
